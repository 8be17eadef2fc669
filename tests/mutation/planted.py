"""Single-line errors of the layers and the tape, each with the tests that should notice it."""

from typing import NamedTuple

ENGINE = "integrators/boundary_value/engine"
TESTS = "tests/integrators"
CONDENSING = f"{TESTS}/engine/test_condensing.py"
ELIMINATION = f"{TESTS}/engine/test_elimination.py"
BARRIERS = f"{TESTS}/engine/test_barrier.py"
TRIAL = f"{TESTS}/engine/test_trial.py"
ARRIVALS = f"{TESTS}/engine/test_arrivals.py"
PURSUIT = f"{TESTS}/engine/test_pursuit.py"
ACCEPTANCE = f"{TESTS}/engine/test_acceptance.py"
SCALING = f"{TESTS}/engine/test_scaling.py"
LIMITS = f"{TESTS}/test_inequalities.py"
FORCES = f"{LIMITS}::test_forces_are_those_of_the_conditions_as_a_bound_becomes_active"
BARRIER = f"{LIMITS}::test_the_barrier_falls_to_its_last_value_in_any_unit_of_the_cost"
UNREACHED = f"{LIMITS}::test_bounds_that_do_not_reach_the_end_are_named"
CONE = f"{LIMITS}::test_derivatives_and_minima_as_a_cone_becomes_active"
ENDS = f"{TESTS}/test_boundary_constraints.py"
PHASES = f"{TESTS}/test_phases.py"
FREE = f"{TESTS}/test_formulation.py"
NODES = f"{TESTS}/test_node_constraints.py"
NODE_ENDS = f"{TESTS}/test_node_ends.py"
RESTING = f"{TESTS}/test_resting_guesses.py"
CLAIMS = f"{TESTS}/test_claims.py"
OPTIMA = f"{TESTS}/test_optima.py"
SECOND = f"{TESTS}/test_second_order.py"
REFINED = f"{TESTS}/test_refinement.py"
MULTIPLIERS = f"{TESTS}/test_multipliers.py"
SOLVER = f"{TESTS}/test_solver.py"
ORDERS = f"{TESTS}/test_solver_orders.py"
STEPS = f"{TESTS}/test_tape_steps.py"
SYMPLECTIC = f"{TESTS}/test_symplectic_step.py"
DIRAC = f"{TESTS}/test_dirac.py"
PARTS = f"{TESTS}/test_step_parts.py"
NO_MINIMUM = f"{TESTS}/test_no_minimum.py"
NUMERICS = "tests/manifolds/test_numerics.py"
ROOTS = "tests/tape/test_roots.py"
LOOPS = "tests/tape/test_loops.py"
TAPE = "tests/tape/test_tape.py"
NATIVE = "tests/tape/test_native.py"
PRIMITIVES = "tests/tape/test_primitives.py"


class Planted(NamedTuple):
    """An error: what a line of a file says, which is said there once, what it says instead, and tests that should fail
    then."""

    file: str
    right: str
    wrong: str
    tests: tuple[str, ...]


PLANTED: dict[str, Planted] = {
    # Those that once survived, and their like.
    "the normal part of the gradient of the terminal cost is dropped": Planted(
        f"{ENGINE}/transcription.py",
        "return cost(point), layout.flat(derivative), vec.components(frame, derivative), curvature",
        "return cost(point), frame.T @ (frame @ layout.flat(derivative)), vec.components(frame, derivative), curvature",
        (f"{CLAIMS}::test_a_terminal_cost_bends_with_its_normal_gradient",),
    ),
    "stages are at the other side of the step in the record": Planted(
        "integrators/boundary_value/posed.py",
        "else np.array([method.theta])",
        "else np.array([1 - method.theta])",
        (MULTIPLIERS, f"{PARTS}::test_stages_of_a_record_are_at_theta"),
    ),
    "a coefficient of Kahan and Li is wrong in its seventh digit": Planted(
        "integrators/initial_value/composition.py",
        "0.38947496264484728641",
        "0.38947486264484728641",
        (f"{PARTS}::test_weights_of_compositions_meet_the_order_conditions_of_one_power",),
    ),
    "RATTLE does not return to the second constraint": Planted(
        "integrators/singular/strategies/rattle.py",
        "q2, p2 = flow(near, last)",
        "q2, p2 = near",
        (f"{TESTS}/singular/test_rattle.py::test_steps_keep_both_constraints_with_the_mean_control_of_the_arc",),
    ),
    "the control of RATTLE lacks the second move along the leaf": Planted(
        "integrators/singular/strategies/rattle.py",
        "_Memory(unknowns, (2 * moved + last) / h)",
        "_Memory(unknowns, 2 * moved / h)",
        (f"{TESTS}/singular/test_rattle.py::test_steps_keep_both_constraints_with_the_mean_control_of_the_arc",),
    ),
    "gap and stationarity are exchanged": Planted(
        f"{ENGINE}/residuals.py",
        "Residuals(*numbers[:RESIDUALS])",
        "Residuals(*numbers[1::-1], *numbers[2:RESIDUALS])",
        (f"{CLAIMS}::test_the_error_holds_what_was_reached_with_gap_and_stationarity_in_their_places",),
    ),
    "a step is not restored to the manifold": Planted(
        "integrators/initial_value/step.py",
        "q = manifold.restore(new.q)",
        "q = new.q",
        (f"{PARTS}::test_a_step_ends_on_the_manifold_from_beside_it",),
    ),
    "Dirac multipliers lack the impulse at the end": Planted(
        "integrators/dirac/dirac_integrator.py",
        "_Memory(last, (root[:m] + last) / h)",
        "_Memory(last, 2 * root[:m] / h)",
        (f"{DIRAC}::test_multipliers_are_of_order_two_at_their_times",),
    ),
    "the predictor of a stage is at the other side of the step": Planted(
        "integrators/stages/hamiltonian.py",
        "vec.scale(self.discretization.theta, velocity)",
        "vec.scale(1 - self.discretization.theta, velocity)",
        (f"{PARTS}::test_predicted_stages_begin_where_the_step_does",),
    ),
    "the predictor of a stage is at theta = 0": Planted(
        "integrators/stages/hamiltonian.py",
        "vec.scale(self.discretization.theta, velocity)",
        "vec.scale(0.0, velocity)",
        (f"{PARTS}::test_predicted_stages_begin_where_the_step_does",),
    ),
    "the predictor of a stage with a control is at theta = 0": Planted(
        "integrators/stages/control.py",
        "vec.scale(self.discretization.theta * self.step,",
        "vec.scale(0.0 * self.step,",
        (f"{PARTS}::test_predicted_stages_begin_where_the_step_does",),
    ),
    "the predictor of a Gauss method is at the begin of the step": Planted(
        "integrators/stages/gauss.py",
        "vec.scale(self.method.theta, ahead)",
        "vec.scale(0.0, ahead)",
        (f"{PARTS}::test_predicted_stages_begin_where_the_step_does",),
    ),
    "a matrix is singular from ten thousand times the tolerance on": Planted(
        "integrators/probing.py",
        "tolerance(matrix, REGULAR)].T",
        "tolerance(matrix, REGULAR) * 1e4].T",
        (f"{PARTS}::test_directions_are_flat_through_the_power_of_the_rounding",),
    ),
    "a start is singular from ten thousand times the tolerance on": Planted(
        "manifolds/numerics/rank.py",
        "values[-1] > tolerance(values, REGULAR) * values[0] > 0",
        "values[-1] > 1e4 * tolerance(values, REGULAR) * values[0] > 0",
        (f"{TESTS}/test_presymplectic_step.py::test_solver_and_integrator_call_the_same_problems_singular",),
    ),
    "regularity is probed at one control": Planted(
        "integrators/probing.py",
        "CURVATURES = 3 ",
        "CURVATURES = 1 ",
        (f"{TESTS}/test_kinks.py::test_every_direction_of_two_controls_is_looked_at",),
    ),
    # Integrators of initial values.
    "the covector of a step is not made tangent": Planted(
        "integrators/initial_value/step.py",
        "return new._replace(q=q, p=manifold.projection(q, new.p))",
        "return new._replace(q=q)",
        (f"{PARTS}::test_a_step_ends_on_the_manifold_from_beside_it",),
    ),
    "the generating function has the cost with the wrong sign": Planted(
        "integrators/initial_value/step.py", "- self.stage.cost(y), r1", "+ self.stage.cost(y), r1", (f"{SYMPLECTIC}",)
    ),
    "the substeps of a composition forget one that failed": Planted(
        "integrators/initial_value/composition.py",
        "converged=last.converged & new.converged",
        "converged=new.converged",
        (f"{PARTS}::test_a_composition_fails_with_any_of_its_substeps",),
    ),
    "the controls of substeps belong to their ends": Planted(
        "integrators/initial_value/composition.py",
        "begins = (np.cumsum(weights) - weights)",
        "begins = np.cumsum(weights)",
        (f"{TESTS}/test_compositions.py",),
    ),
    "a loop goes on after a step that failed": Planted(
        "integrators/initial_value/loop.py",
        "good = new.converged & (carry.failed_step < 0)",
        "good = carry.failed_step < 0",
        (f"{TESTS}/test_trajectory.py", f"{STEPS}::test_both_fail_at_the_same_step_or_both_succeed"),
    ),
    "lanes go on after a step that failed": Planted(
        "integrators/initial_value/step_kernels.py",
        "v[places[GOOD], j] * v[places[CONVERGED], j] * (v[places[FINITE], j] != 0)",
        "v[places[GOOD], j] * (v[places[FINITE], j] != 0)",
        (f"{STEPS}::test_a_step_fails_exactly_where_its_equations_have_no_solution",),
    ),
    "the first ratio of steps is that of all unknowns": Planted(
        "integrators/initial_value/step_kernels.py",
        "else np.sqrt(ratio) if n == 1 else ratio",
        "else ratio",
        (f"{STEPS}::test_a_system_moves_the_same_beside_another_one_whose_steps_are_found_at_once",),
    ),
    "a Jacobian of lanes is inverted with its smallest pivots": Planted(
        "integrators/initial_value/inverse_kernels.py",
        "if abs(a[i, k, j]) * largest[best, j] > abs(a[best, k, j]) * largest[i, j]:",
        "if abs(a[i, k, j]) * largest[best, j] < abs(a[best, k, j]) * largest[i, j]:",
        (f"{STEPS}", f"{TESTS}/test_gauss.py::test_a_trajectory_has_a_control_for_each_point_at_its_time"),
    ),
    "the record of lanes has the state before the step": Planted(
        "integrators/initial_value/step_kernels.py",
        "record[(phase + index) // every, i, first + j]",
        "record[(phase + index) // (every + 1), i, first + j]",
        (f"{STEPS}",),
    ),
    "inverse Jacobians of small steps are not inverted": Planted(
        "integrators/stages/hamiltonian.py",
        "return np.kron(np.linalg.inv(blocks), np.eye(n))",
        "return np.kron(blocks, np.eye(n))",
        (f"{PARTS}::test_the_inverse_of_small_steps_is_that_of_the_equations",),
    ),
    "the covector at a stage has the first end with the wrong sign": Planted(
        "integrators/stages/control.py",
        "pull((vec.scale(-1.0, p0), p1))",
        "pull((p0, p1))",
        (f"{MULTIPLIERS}::test_the_controls_make_the_hamiltonian_stationary_at_the_stage_costates",),
    ),
    # Ranks.
    "a rank is measured by the largest singular value alone": Planted(
        "manifolds/numerics/rank.py",
        "relative * max(values[0], unit)",
        "relative * values[0]",
        ("tests/manifolds/test_rank.py",),
    ),
    "ranks are decided by what counts alone": Planted(
        "integrators/singular/integrability/echelon.py",
        "(self.smallest >= CERTAIN) & (self.largest <= ZERO)",
        "self.smallest >= CERTAIN",
        (f"{TESTS}/singular/test_ranks.py",),
    ),
    # Retractions.
    "the lift has the transposed matrix": Planted(
        "retractions/cotangent_lift.py",
        "jnp.linalg.solve(matrix, vec.components(frame, p))",
        "jnp.linalg.solve(matrix.T, vec.components(frame, p))",
        (
            "tests/retractions/test_lifted_diffeomorphisms.py::test_a_rotation_of_the_sphere_rotates_covectors",
            "tests/retractions/test_lifted_diffeomorphisms.py::test_the_lift_is_functorial",
        ),
    ),
    "the adjoint of a map has the theta of the map": Planted(
        "retractions/discretization.py",
        "return 1 - self.inner.theta",
        "return self.inner.theta",
        (
            "tests/retractions/test_discretization.py::test_the_adjoint_of_theta_is_one_minus_theta_with_the_retractions_exchanged",
        ),
    ),
    "the inverse of the adjoint has the other sign": Planted(
        "retractions/discretization.py",
        "x, v = self.inner.preimage(x1, x0)\n        return x, vec.scale(-1.0, v)",
        "x, v = self.inner.preimage(x1, x0)\n        return x, v",
        ("tests/retractions/test_discretization.py::test_the_inverse_of_an_adjoint_returns",),
    ),
    "the second-order correction is twice as long": Planted(
        "retractions/constructions/second_order.py",
        "vec.scale(0.5, ",
        "vec.scale(1.0, ",
        ("tests/retractions/test_order.py::test_the_correction_takes_half_the_acceleration",),
    ),
    "the acceleration lacks the force of the metric": Planted(
        "retractions/constructions/second_order.py",
        "vec.subtract(rate, force)))",
        "rate))",
        ("tests/retractions/test_order.py",),
    ),
    "the tableau of Gauss is not about the middle": Planted(
        "retractions/gauss.py",
        "centred, centred + b / 2)",
        "centred + b / 2, centred + b / 2)",
        ("tests/retractions/test_gauss.py",),
    ),
    "the logarithm of the sphere is that of the chord": Planted(
        "retractions/vectors/sphere.py",
        "series.angle_over_sine(w @ w, c) * w",
        "w",
        ("tests/retractions/test_domains.py",),
    ),
    "the adjoint derivative of great circles lacks the turned part": Planted(
        "retractions/vectors/sphere.py",
        "sinc * xi - (turned @ xi) * v)",
        "sinc * xi)",
        ("tests/retractions/test_differentials.py",),
    ),
    "the Cayley map of rotations is differentiated on one side": Planted(
        "retractions/groups/special_orthogonal.py",
        "return x @ h @ self.manifold.left_trivialise(x, w) @ h",
        "return x @ h @ self.manifold.left_trivialise(x, w)",
        ("tests/retractions/test_differentials.py",),
    ),
    "an inverse that was not found is returned": Planted(
        "retractions/retraction.py",
        "return nan_unless(converged & reached, v)",
        "return nan_unless(converged | reached, v)",
        ("tests/retractions/test_newtons_inverse.py", "tests/retractions/test_domains.py"),
    ),
    "nobody looks whether functions have changed": Planted(
        "integrators/unchanged.py",
        "if reading.traces > before:",
        "if not reading.traces:",
        ("tests/integrators/test_unchanged.py",),
    ),
    "equations of a manifold are traced for every object": Planted(
        "integrators/evaluation.py",
        'key = "violations", structure, *map(id, leaves)',
        'key = "violations", id(manifold)',
        ("tests/integrators/test_unchanged.py",),
    ),
    "a mesh follows the one that was stopped": Planted(
        "integrators/boundary_value/refinement.py",
        "raise _StoppedError",
        "self._most = MOST_STAGES",
        ("tests/integrators/test_stops.py",),
    ),
    "exponentials far out are computed once": Planted(
        "retractions/groups/matrix_group.py",
        "for k in (-2, -1, 0, 1, 2)])",
        "for k in (0, 0)])",
        ("tests/retractions/test_rounding_of_groups.py",),
    ),
    "logarithms lead off the group": Planted(
        "retractions/groups/matrix_group.py",
        "return nan_unless(self._stays_on_group(jax.lax.stop_gradient(a), INVERTED), a)",
        "return a",
        ("tests/retractions/test_rounding_of_groups.py",),
    ),
    # The tape.
    "the machine takes the smaller for the larger": Planted(
        "src/retrax/tape/machine.py",
        "return x if x > y or y != y else y",
        "return x if x < y or y != y else y",
        (PRIMITIVES,),
    ),
    "fused products are added where they are subtracted": Planted(
        "src/retrax/tape/emitted.py",
        '"SUB_MUL": lambda b, v, x, y, z: _fused(b, b.fneg(x()), y(), z()),',
        '"SUB_MUL": lambda b, v, x, y, z: _fused(b, x(), y(), z()),',
        (TAPE, PRIMITIVES),
    ),
    "rows of machine code are given away while others need them": Planted(
        "src/retrax/tape/native.py",
        "ends.setdefault(max(last.get(k, number), number), []).append(rows[k])",
        "ends.setdefault(number, []).append(rows[k])",
        (NATIVE,),
    ),
    "machine code writes what it reads": Planted(
        "src/retrax/tape/transfers.py",
        "data[begin + j * step] = w[row + i, j]",
        "data[begin + j * step] = w[i, j]",
        (NATIVE,),
    ),
    "machine code reads the points of the first vector for all": Planted(
        "src/retrax/tape/machine.py",
        "read_all(inputs, view(sources, 2 * at, (some, 2)), w, row, s, m)",
        "read_all(inputs, view(sources, 2 * at, (some, 2)), w, row, 0, m)",
        (f"{NATIVE}::test_any_number_of_points",),
    ),
    "machine code is made of tapes that run once": Planted(
        "src/retrax/tape/often.py",
        "if self._points > OFTEN and not self._asked:",
        "if not self._asked:",
        (f"{NATIVE}::test_it_is_made_after_so_many_points",),
    ),
    "lanes write one point too few": Planted(
        "src/retrax/tape/machine.py",
        "m, k, left = min(lanes, last - s), 0, 0",
        "m, k, left = min(lanes, last - s - 1), 0, 0",
        (f"{TAPE}::test_any_number_of_points",),
    ),
    "substitution in triangular systems does not divide": Planted(
        "src/retrax/tape/linear.py",
        "found[i, :] = row if unit else row / matrix[i, i]",
        "found[i, :] = row",
        (PRIMITIVES,),
    ),
    "the factors are not pivoted": Planted(
        "src/retrax/tape/linear.py",
        "bigger = ca.fabs(a[i, k]) > best",
        "bigger = ca.fabs(a[i, k]) < 0 * best",
        (PRIMITIVES,),
    ),
    "the reflections have the other sign": Planted(
        "src/retrax/tape/linear.py",
        "select(r[k, k] < 0, size, -size)",
        "select(r[k, k] < 0, -size, size)",
        (PRIMITIVES,),
    ),
    "a product of complex numbers lacks its second part": Planted(
        "src/retrax/tape/pairs.py",
        "return x[0] * y[0] - x[1] * y[1], x[0] * y[1] + x[1] * y[0]",
        "return x[0] * y[0], x[0] * y[1] + x[1] * y[0]",
        (PRIMITIVES,),
    ),
    "a gradient stops at the last mark": Planted(
        "src/retrax/tape/graph.py",
        "adjoint += ca.jtimes(mark.arguments, symbols, pulled, True)",
        "adjoint += 0 * ca.jtimes(mark.arguments, symbols, pulled, True)",
        (f"{TAPE}::test_derivatives_go_through_derivatives_of_ones_own",),
    ),
    "a direction is pushed through no mark": Planted(
        "src/retrax/tape/graph.py",
        "return sum(moved, start=ca.jtimes(values, by, direction))",
        "return ca.jtimes(values, by, direction)",
        (f"{TAPE}::test_derivatives_go_through_derivatives_of_ones_own",),
    ),
    "the expansion has the lower triangle alone": Planted(
        "src/retrax/tape/tape.py",
        "curvature = ca.tril2symm(ca.tril(curvature))",
        "curvature = ca.tril(curvature)",
        (CONDENSING, f"{CLAIMS}::test_a_terminal_cost_bends_with_its_normal_gradient"),
    ),
    # The engine: blocks, condensing, elimination.
    "the condensed Hessian lacks the ends": Planted(
        f"{ENGINE}/condensing_kernels.py",
        "for i in range(s + 1):\n            at_ends = i == s\n            _map(",
        "for i in range(s):\n            at_ends = i == s\n            _map(",
        (CONDENSING,),
    ),
    "the slope of points is not condensed": Planted(
        f"{ENGINE}/condensing_kernels.py",
        "put_entry(y, a, z + j, -entry(slope, a, j))",
        "put_entry(y, a, z + j, 0.0)",
        (CONDENSING,),
    ),
    "multipliers of points have the other sign": Planted(
        f"{ENGINE}/condensing_kernels.py", "out[1][t, i] = -x[i]", "out[1][t, i] = x[i]", (CONDENSING,)
    ),
    "gaps do not know of the velocities before": Planted(
        f"{ENGINE}/condensing.py", "gap[:, :-1] += self.before", "gap[:, :-1] += 0 * self.before", (CONDENSING,)
    ),
    "the weights of elimination stay in the multipliers": Planted(
        f"{ENGINE}/elimination_kernels.py", "x[j, p + a] - weight * moved", "x[j, p + a]", (ELIMINATION,)
    ),
    "a small pivot is a clear one": Planted(
        "manifolds/numerics/tolerances.py",
        "REGULAR = 0.6 ",
        "REGULAR = 2.0 ",
        (ELIMINATION, f"{SECOND}::test_half_a_turn_is_one_of_many_and_no_strict_minimum"),
    ),
    "a shift raises the Hessian without its scales": Planted(
        f"{ENGINE}/elimination_kernels.py",
        "v[i, i] += raised[0][0] * raised[1][i]",
        "v[i, i] += raised[0][0]",
        (ELIMINATION,),
    ),
    "velocities of collocation are not weighted by the step": Planted(
        f"{ENGINE}/collocation.py",
        "lagrangian = cost + multipliers @ defect + weight[0] * pull @ limits",
        "lagrangian = cost + multipliers @ defect + pull @ limits",
        (f"{LIMITS}::test_units_do_not_matter", f"{LIMITS}::test_derivatives_with_active_bounds"),
    ),
    "the frame of collocation is not carried along": Planted(
        f"{ENGINE}/collocation.py",
        'velocities = np.einsum("bkac,bkic->bkia", turns, unknowns',
        'velocities = np.einsum("bkca,bkic->bkia", turns, unknowns',
        (f"{ORDERS}", f"{SOLVER}::test_both_evaluators_give_the_same_numbers"),
    ),
    "costates of the points are between the nodes the wrong way round": Planted(
        f"{ENGINE}/collocation.py",
        "between = (1 - place) * costates[:, :-1, None] + place * costates[:, 1:, None]",
        "between = place * costates[:, :-1, None] + (1 - place) * costates[:, 1:, None]",
        (f"{TESTS}/test_between_nodes.py", f"{PARTS}::test_points_are_guessed_between_the_costates_of_the_nodes"),
    ),
    "the covector of the last node lacks the cost": Planted(
        f"{ENGINE}/kkt_system.py",
        "turned[:, -1] += sign * terminal.derivative",
        "turned[:, -1] += 0 * terminal.derivative",
        (f"{OPTIMA}::test_at_a_free_end_the_costate_is_minus_the_derivative_of_the_terminal_cost",),
    ),
    "the Hessian of the last step lacks that of the terminal cost": Planted(
        f"{ENGINE}/kkt_system.py",
        "blocks.hessian[:, place] += end.mT @ paid.curvature @ end",
        "blocks.hessian[:, place] += 0 * end.mT @ paid.curvature @ end",
        (f"{PARTS}::test_the_curvature_of_a_terminal_cost_counts",),
    ),
    "every iteration on a tape is said to converge": Planted(
        "src/retrax/tape/roots.py",
        "return c, select(step",
        "return c, 1 + 0 * select(step",
        (f"{ROOTS}::test_no_claim_of_convergence_is_false",),
    ),
    "a column that is zero below its diagonal changes its sign": Planted(
        "src/retrax/tape/linear.py",
        "turned = select(ca.logic_or(below > 0, none), 1.0, -1.0)",
        "turned = select(ca.logic_or(below > 0, none), 1.0, 1.0)",
        ("tests/tape/test_triangular_matrices.py",),
    ),
    "a loop gives the registers of what it is given to others": Planted(
        "src/retrax/tape/program.py",
        "last = lasting(last, {k: row for row, k in enumerate(kept)}, [instructions[k].name for k in kept])",
        "last = dict(last)",
        (LOOPS,),
    ),
    "machine code gives the rows of what a loop is given to others": Planted(
        "src/retrax/tape/native.py",
        "last = lasting(last, piece_of, [lines[piece.lines[0]].name for piece in pieces])",
        "last = dict(last)",
        (LOOPS,),
    ),
    "a loop ends with the first point that is done": Planted(
        "src/retrax/tape/machine.py",
        "going |= done[j] == 0",
        "going = done[j] == 0",
        (f"{ROOTS}::test_a_root_does_not_depend_on_the_points_that_it_is_computed_with",),
    ),
    "numbers of a state are not copied before they are replaced": Planted(
        "src/retrax/tape/instructions.py",
        'if found[made].name == "STATE" else made',
        'if found[made].name == "OUTPUT" else made',
        (LOOPS,),
    ),
    "sides of a jump are compared where they are rounding": Planted(
        "integrators/crossings.py",
        "& clear[:, before] & clear[:, after]",
        "",
        (f"{TESTS}/test_state_jumps.py::test_jumps_are_seen_wherever_they_are",),
    ),
    "gradients of functions of XLA are twice as long": Planted(
        "integrators/evaluator.py",
        "return curvature, scalar_slope[0], *jax",
        "return curvature, 2 * scalar_slope[0], *jax",
        (f"{PARTS}::test_evaluators_have_the_same_derivatives",),
    ),
    "tapes are as large as they may be, but for one operation": Planted(
        "integrators/tape_evaluator.py",
        "tape = size if size > most else",
        "tape = size if size >= most else",
        (
            "tests/integrators/test_evaluators.py::test_a_solver_runs_on_the_tape_as_far_as_its_graphs_are_not_too_large",
        ),
    ),
    "products with truths multiply": Planted(
        "src/retrax/tape/instructions.py",
        "if name in TRUTHS:",
        "if name in ():",
        (f"{PRIMITIVES}::test_values_and_two_derivatives_are_those_of_xla[truth as a factor]",),
    ),
    "constants that are not finite are branches as others": Planted(
        "src/retrax/tape/choice.py",
        "if not (over.any() or under.any()):",
        "if True:",
        (f"{PRIMITIVES}::test_casadi_derives_choices_of_what_is_not_finite",),
    ),
    "a skew matrix is half its own dual": Planted(
        "retractions/groups/functions/rotations.py",
        "return jnp.block([[jnp.zeros((1, 1), omega.dtype), -rest[None]], [rest[:, None], -hat(first)]])",
        "return jnp.block([[jnp.zeros((1, 1), omega.dtype), rest[None]], [-rest[:, None], -hat(first)]])",
        (
            "tests/retractions/test_matrix_retractions.py::test_the_exponential_in_four_dimensions_has_the_derivatives_of_"
            "the_general_one",
        ),
    ),
    "the first column is the pivot": Planted(
        "manifolds/numerics/frames.py",
        "names == jnp.argmax(jnp.diagonal(a))",
        "names == 0",
        ("tests/manifolds/test_tangent_spaces.py::test_is_a_manifold[Gr42]",),
    ),
    "vectors of NumPy keep what is not a number out": Planted(
        f"{ENGINE}/numpy_vectors.py",
        "return np.where((y > x) | np.isnan(y), y, x)",
        "return np.where(y > x, y, x)",
        (f"{TESTS}/engine/test_vectors.py",),
    ),
    "shared arguments of tapes go on from point to point": Planted(
        "integrators/tape_evaluator.py",
        "size if length > 1 else 0) for k",
        "size) for k",
        (f"{SOLVER}::test_both_evaluators_give_the_same_numbers", f"{FREE}"),
    ),
    # Newton's method.
    "anything that is finite is accepted": Planted(
        f"{ENGINE}/acceptance_kernels.py",
        "accepted = improves or (inside and residual <= max(record * best, tolerance))",
        "accepted = residual < np.inf",
        (ACCEPTANCE,),
    ),
    "a record leads anywhere": Planted(
        f"{ENGINE}/acceptance_kernels.py",
        "inside = shortfall <= max(funnel, tolerance)",
        "inside = shortfall < np.inf",
        (f"{ACCEPTANCE}::test_a_record_counts_inside_the_funnel_only",),
    ),
    "what is rounding measures a coordinate": Planted(
        f"{ENGINE}/extent_kernels.py",
        "far if far > rounding * whole else 0.0, most",
        "far if far > 0 * whole else 0.0, most",
        (f"{SCALING}::test_a_coordinate_moves_by_more_than_half_of_the_digits_of_its_column_or_not_at_all",),
    ),
    "success is claimed wherever residuals are small": Planted(
        f"{ENGINE}/descent.py",
        "isolated = arrived & (wanted <= np.sqrt(self.tolerance))",
        "isolated = arrived",
        (f"{CLAIMS}", f"{SOLVER}::test_success_across_a_conjugate_point"),
    ),
    "a trajectory has kept its size in wider units": Planted(
        f"{ENGINE}/conditions.py",
        "extent, controls, units = assembled.extent, self.control_sizes(iterate), self.judging.unknowns",
        "extent, controls, units = assembled.extent, self.control_sizes(iterate), self.measured.unknowns",
        (f"{TESTS}/test_far_ends.py::test_a_trajectory_that_grows_without_end_is_no_success",),
    ),
    "the Hessian is never raised": Planted(
        f"{ENGINE}/descent.py",
        "going = ~(descends | keep) & (shift < LARGEST_SHIFT)",
        "going = ~(descends | keep) & (shift < 0)",
        (f"{PARTS}::test_from_a_hill_it_goes_down",),
    ),
    "a saddle that is reached is a minimum": Planted(
        f"{ENGINE}/descent.py",
        "strict & whole.isolated,",
        "whole.isolated,",
        (f"{SECOND}",),
    ),
    "members of a batch come in the order in which they left": Planted(
        f"{ENGINE}/descent.py",
        "order = np.argsort(np.concatenate([state.member for state in states]))",
        "order = np.arange(sum(map(len, counts)))",
        (
            f"{SOLVER}::test_members_that_have_converged_leave_and_one_that_cannot_be_solved_spoils_none",
            f"{SOLVER}::test_a_batch_is_a_loop_over_its_members",
        ),
    ),
    "parts of a batch come in another order": Planted(
        f"{ENGINE}/parallel.py",
        "arrays: Any = [found._replace(stopped=None) for _, found in parts]",
        "arrays: Any = [found._replace(stopped=None) for _, found in parts[::-1]]",
        (f"{TESTS}/test_parts_of_a_batch.py",),
    ),
    "members that arrive in passes come before all others": Planted(
        f"{ENGINE}/parallel.py",
        "return taken(joined(arrays), order)",
        "return joined(arrays)",
        (ARRIVALS,),
    ),
    "members that arrive in passes have the units of others": Planted(
        f"{ENGINE}/parallel.py",
        "conditions.adopt([own for own, _ in parts], order)",
        "conditions.adopt([own for own, _ in parts[::-1]], order)",
        (ARRIVALS,),
    ),
    "what is kept of a pass is not where it has arrived": Planted(
        f"{ENGINE}/trial.py",
        "kept.numbers[k] = places[(trials[k] - 1) % 2].numbers",
        "kept.numbers[k] = places[trials[k] % 2].numbers",
        (ARRIVALS,),
    ),
    "a residual that is rounding ends a pass though its step is long": Planted(
        f"{ENGINE}/pursuit_kernels.py",
        "if arrived and not _settled(standing, given, written, rows, rules[4], rules[8][1]):",
        "if arrived and numbers[8, 0] > rules[5] and not _settled("
        "standing, given, written, rows, rules[4], rules[8][1]):",
        (f"{TESTS}/engine/test_pursuit.py",),
    ),
    "members of all parts have the units of the first": Planted(
        f"{ENGINE}/conditions.py",
        "self.units, self.barrier = every([own.units for own in parts]), every([own.barrier for own in parts])",
        "self.units, self.barrier = every([parts[0].units for own in parts]), every([own.barrier for own in parts])",
        (f"{TESTS}/test_parts_of_a_batch.py::test_limited_slews_are_the_same_in_parts",),
    ),
    "the rounding of one unknown ends the search for others": Planted(
        "manifolds/numerics/chord_newton.py",
        "jnp.abs(missed) <= PROBE * jnp.maximum(changed, smallest)",
        "jnp.abs(missed) <= PROBE * jnp.max(changed)",
        (f"{NUMERICS}::test_an_unknown_that_rounding_alone_decides_does_not_end_the_search_for_others",),
    ),
    "gaps are not asked of the nodes": Planted(
        f"{ENGINE}/extent_kernels.py",
        "found[0, m] = larger(found[0, m], points[m, 0, a] / (along[m, a] if along[m, a] > 0 else 1.0))",
        "found[0, m] = larger(found[0, m], 0.0)",
        (f"{PARTS}::test_the_gap_has_the_defects_of_the_points",),
    ),
    "fixed coordinates of the ends are free": Planted(
        f"{ENGINE}/conditions.py",
        "fixed[:, 0], fixed[:, -1] = self.ends.start_coordinates, self.ends.end_coordinates",
        "fixed[:, 0], fixed[:, -1] = self.ends.end_coordinates, self.ends.start_coordinates",
        (f"{OPTIMA}",),
    ),
    # Steps that keep their length, borders, phases.
    "a step may lead further than the diameter": Planted(
        f"{ENGINE}/share.py",
        "return DIAMETER / np.maximum(_turns(parts, kept), DIAMETER)",
        "return np.ones(len(farthest))",
        (f"{TESTS}/test_long_steps.py",),
    ),
    "lengths that change are kept": Planted(
        f"{ENGINE}/share.py",
        "_turns(parts, kept)",
        "_turns(parts, same)",
        (f"{TESTS}/test_long_steps.py", f"{PARTS}::test_steps_of_a_flat_space_are_followed_whole"),
    ),
    "the border has its equations with the other sign": Planted(
        f"{ENGINE}/border.py",
        "side[:, mu] = -coupled.values",
        "side[:, mu] = coupled.values",
        (f"{ENDS}::test_an_end_on_a_circle_from_inside_to_outside",),
    ),
    "the border keeps the weight of the end": Planted(
        f"{ENGINE}/border.py",
        "matrix[:, moved, moved] -= part.weight[:, last]",
        "matrix[:, moved, moved] -= 0 * part.weight[:, last]",
        (f"{ENDS}::test_an_end_on_a_circle_from_inside_to_outside",),
    ),
    "the curvature of what couples the ends is left out": Planted(
        f"{ENGINE}/border.py",
        "matrix[:, : p + q, : p + q] = coupled.curvature[:, free][:, :, free]",
        "matrix[:, : p + q, : p + q] = 0 * coupled.curvature[:, free][:, :, free]",
        (f"{PARTS}::test_the_curvature_of_boundary_constraints_counts",),
    ),
    "equations between ends count for no gap": Planted(
        f"{ENGINE}/joint.py",
        "np.maximum(self._gap(iterate, assembled), largest.gap)",
        "largest.gap",
        (f"{ENDS}",),
    ),
    "the cost of phases is that of the first": Planted(
        f"{ENGINE}/joint_system.py",
        "return sum((part.cost for part in self.parts), np.zeros(len(self.coupled.values)))",
        "return self.parts[0].cost + np.zeros(len(self.coupled.values))",
        (f"{PHASES}::test_bang_bang_arcs_of_a_double_integrator",),
    ),
    # The compiled pass of a trial.
    "covectors of a trial are those before the step": Planted(
        f"{ENGINE}/trial_kernels.py",
        "f = coordinates[0, k, a] + share * multipliers[0, k, a, 0]",
        "f = coordinates[0, k, a]",
        (TRIAL,),
    ),
    "a trial has the multipliers of the first inequality only": Planted(
        f"{ENGINE}/one_stage_kernels.py",
        "put(read, at, multipliers, 0, multipliers.size)",
        "put(read, at, multipliers, 0, 1)",
        (TRIAL,),
    ),
    "ends far apart have a compiled pass": Planted(
        f"{ENGINE}/trial_kernels.py",
        "return not _meet(calls[AT_MEET], (begins, finishes, ends_of(setting, rows), columns, far, work, met))",
        "return not _meet(calls[AT_MEET], (begins, finishes, ends_of(setting, rows), columns, far, work, met)) or k",
        (TRIAL,),
    ),
    "velocities of a trial are those before the step": Planted(
        f"{ENGINE}/collocation_kernels.py",
        "value += turns[k, a, c] * (given[k, i, c] + part * velocity_steps[k, first + c])",
        "value += turns[k, a, c] * given[k, i, c]",
        (TRIAL,),
    ),
    "velocities of a trial stay in the frame before the step": Planted(
        f"{ENGINE}/collocation_kernels.py",
        "value += turns[k, a, c] * (given[k, i, c] + part * velocity_steps[k, first + c])",
        "value += (a == c) * (given[k, i, c] + part * velocity_steps[k, first + c])",
        (TRIAL,),
    ),
    "a condensed step leaves what its points lack to the nodes": Planted(
        f"{ENGINE}/collocation_kernels.py",
        "lacks[k + 1, a] -= after[k, a, 0]",
        "lacks[k + 1, a] -= 0.0",
        (PURSUIT,),
    ),
    "the multipliers of points promise nothing": Planted(
        f"{ENGINE}/collocation_kernels.py",
        "change[1] += lambdas[k, i] * defect[k, i]",
        "change[1] += 0.0",
        (PURSUIT,),
    ),
    "velocities that mend the defects cost nothing": Planted(
        f"{ENGINE}/collocation_kernels.py",
        "change[0] += inside[1][k, i] * value",
        "change[0] += 0.0",
        (PURSUIT,),
    ),
    "units of a pass are those of the first step's controls": Planted(
        f"{ENGINE}/pursuit_kernels.py",
        "largest = larger(largest, abs(controls[k, i - n]))",
        "largest = larger(largest, abs(controls[0, i - n]))",
        (PURSUIT,),
    ),
    "a pursuit takes what a trial is refused for": Planted(
        f"{ENGINE}/pursuit_kernels.py",
        "if not good or shift >= stiff:",
        "if shift >= stiff:",
        (f"{PURSUIT}::test_what_is_refused_is_left_to_the_rest_of_the_iteration",),
    ),
    "a pass forgets the shift of the Hessians": Planted(
        f"{ENGINE}/pursuit_kernels.py",
        "raised[0][0] = standing_of(written, rows)[SHIFT]",
        "raised[0][0] = 0.0",
        (PURSUIT,),
    ),
    "a pass keeps its shift to the end": Planted(
        f"{ENGINE}/pursuit_kernels.py",
        "kept[SHIFT] = 0.0 if arrived and not last else kept[SHIFT]",
        "kept[SHIFT] = kept[SHIFT]",
        (PURSUIT,),
    ),
    "what controls reach has no end": Planted(
        f"{ENGINE}/scaling_kernels.py",
        "unit = min(unit, _farthest(sizes[m], reach, i, n))",
        "unit = min(unit, np.inf)",
        ("tests/integrators/test_unstable_plants.py",),
    ),
    "rounding hides that a cost is flat": Planted(
        f"{ENGINE}/descent.py",
        "flat = ~descends | (shift > 0) | (linear & ~step.strict & has_flat_controls(assembled))",
        "flat = ~descends | (shift > 0)",
        ("tests/integrators/test_arrival.py",),
    ),
    "steps past saddles descend": Planted(
        f"{ENGINE}/descent.py",
        "descends[places] = (curvature >= CURVATURE * size) & convex",
        "descends[places] = curvature >= CURVATURE * size",
        ("tests/integrators/test_arrival.py", SOLVER, BARRIERS, UNREACHED),
    ),
    "rounding refuses what leads to a solution": Planted(
        f"{ENGINE}/acceptance_kernels.py",
        "less = now[1] + now[2] <= least + rounded * (abs(before[1]) + abs(before[2]))",
        "less = now[1] + now[2] <= least",
        (ACCEPTANCE,),
    ),
    "a search sets out wherever its first step leads": Planted(
        f"{ENGINE}/pursuit_kernels.py",
        "return spread > 0 and moved <= far * spread and (asked <= met or over <= unmet * asked)",
        "return True",
        (f"{PURSUIT}::test_how_far_a_first_step_may_lead_is_swept",),
    ),
    "any last step is Newton's last": Planted(
        f"{ENGINE}/pursuit_kernels.py",
        "if not wanted <= least or wanted > shrinks * standing[CORRECTION]:",
        "if not wanted <= least * 1e300:",
        (PURSUIT,),
    ),
    "a pursuit turns by more than a half turn": Planted(
        f"{ENGINE}/pursuit_kernels.py",
        "within &= size == 0 or by <= size",
        "within &= size == 0 or by >= 0",
        (PURSUIT,),
    ),
    # Inequalities.
    "the barrier ends far above its last value": Planted(
        f"{ENGINE}/barrier.py",
        "own = plain(slacks.barrier), rate, LAST * tolerance * self.rate / rate",
        "own = plain(slacks.barrier), rate, 1e4 * tolerance * self.rate / rate",
        (BARRIERS, BARRIER),
    ),
    "excesses stay as cheap as they are": Planted(
        f"{ENGINE}/inequality_kernels.py",
        "        if told or not own > (1 + reached) * last:\n            return barrier, told",
        "        if told or not own > (1 + reached) * last:\n            return barrier, False",
        (BARRIERS,),
    ),
    "a barrier is lowered before its problem is solved": Planted(
        f"{ENGINE}/inequality_kernels.py",
        "if not (error <= max(few * barrier / rate, tolerance) and off <= few * barrier):",
        "if not (error <= max(1e3 * few * barrier / rate, tolerance) and off <= 1e3 * few * barrier):",
        (BARRIERS,),
    ),
    "a pass lowers the barrier to another last value": Planted(
        f"{ENGINE}/limit_kernels.py",
        "less, cheap = lowered(before, rate, last * tolerance * limits[1][0] / rate,",
        "less, cheap = lowered(before, rate, 1e4 * last * tolerance * limits[1][0] / rate,",
        (PURSUIT,),
    ),
    "what a lower barrier costs is not measured anew": Planted(
        f"{ENGINE}/limit_kernels.py",
        "    set_out(standing, numbers)\n    standing[FIRST] = 0.0\n    return LESS",
        "    return LESS",
        (PURSUIT,),
    ),
    "a step that bounds stop promises all of itself": Planted(
        f"{ENGINE}/pursuit_kernels.py",
        "change[0] = part[0] * (change[0] + way[0, 2])",
        "change[0] = change[0] + way[0, 2]",
        (PURSUIT,),
    ),
    "a pass goes on where inequalities contradict each other": Planted(
        f"{ENGINE}/limit_kernels.py",
        "return left or part_of(written, rows)[0] <= jammed",
        "return part_of(written, rows)[0] <= jammed",
        (PURSUIT,),
    ),
    "a pass goes on where a step jams": Planted(
        f"{ENGINE}/limit_kernels.py",
        "return left or part_of(written, rows)[0] <= jammed",
        "return left",
        (PURSUIT,),
    ),
    "the barrier has no share in the slopes of points": Planted(
        f"{ENGINE}/collocation_kernels.py",
        "slopes[k, i, a] = columns[0, k, i, a, 0] + barrier * columns[0, k, i, a, 1]",
        "slopes[k, i, a] = columns[0, k, i, a, 0]",
        (PURSUIT,),
    ),
    "inequalities at points do not see what velocities move these by": Planted(
        f"{ENGINE}/collocation_kernels.py",
        "place(ways[0, k, i], w[k], velocities[k], h[k], matrix[i], (n, q - 3 * n, i))",
        "place(ways[0, k, i], w[k], velocities[k], 0.0, matrix[i], (n, q - 3 * n, i))",
        (PURSUIT,),
    ),
    "what points lack counts in the share of the barrier too": Planted(
        f"{ENGINE}/collocation_kernels.py",
        "defects[k, i, a, 0], defects[k, i, a, 1] = missed[0, k, i, a], 0.0",
        "defects[k, i, a, 0], defects[k, i, a, 1] = missed[0, k, i, a], missed[0, k, i, a]",
        (TRIAL,),
    ),
    "all points of a step have its whole length as a weight": Planted(
        f"{ENGINE}/collocation.py",
        "own = np.array([*self.tableau.weights, 1.0][: self.places])",
        "own = np.array([*np.ones(self.stages), 1.0][: self.places])",
        ("tests/integrators/test_inequalities.py",),
    ),
    "nothing is impossible": Planted(
        f"{ENGINE}/barrier.py",
        "return (error <= tolerance) & (small & (found.left > np.sqrt(tolerance)) | last)",
        "return (error <= tolerance) & small & (found.left > 1 / tolerance)",
        (UNREACHED,),
    ),
    "steps go to the boundary": Planted(f"{ENGINE}/inequalities.py", "BOUNDARY = 0.99 ", "BOUNDARY = 1.0 ", (LIMITS,)),
    "stiffness has the excess of hard inequalities": Planted(
        f"{ENGINE}/inequalities.py",
        "return nu / (slacks.slacks + np.where(slacks.elastic, nu * slacks.excess / slacks.rest, 0.0))",
        "return nu / (slacks.slacks + nu)",
        (BARRIERS,),
    ),
    "multipliers at the end are those of hard inequalities": Planted(
        f"{ENGINE}/augmented.py",
        "hessian[..., z:, z:] = -give[..., None] * np.eye(c)",
        "hessian[..., z:, z:] = give[..., None] * np.eye(c)",
        (FORCES, CONE),
    ),
    # What is free, arcs, structures, errors of steps.
    "the time of a free horizon is that of the guess": Planted(
        "integrators/boundary_value/formulation.py",
        "times=rate * found.times,",
        "times=found.times,",
        (f"{FREE}::test_a_free_horizon_is_found_from_far_above_and_below",),
    ),
    "the rate of the cost lacks that of the time": Planted(
        "integrators/boundary_value/formulation.py",
        "return rate * bound.cost_rate(q, u)",
        "return bound.cost_rate(q, u)",
        (f"{FREE}::test_a_free_horizon_is_found_from_far_above_and_below",),
    ),
    "an upper bound of the horizon is a lower one": Planted(
        "integrators/boundary_value/formulation.py",
        "kind.horizon_bounds, (1, -1), strict=True)",
        "kind.horizon_bounds, (1, 1), strict=True)",
        (f"{FREE}::test_a_bound_of_the_horizon_from_where_it_holds_to_where_it_does_not",),
    ),
    "bounds of a guess are not looked at": Planted(
        "integrators/free.py",
        'if not np.all((arrays["lower"] <= arrays["guess"]) & (arrays["guess"] <= arrays["upper"])):',
        'if not np.all(arrays["lower"] <= arrays["guess"]):',
        (f"{FREE}::test_what_is_not_free_is_named", f"{FREE}::test_free_is_frozen"),
    ),
    "the last arc has no duration": Planted(
        "integrators/boundary_value/arcs.py",
        "jnp.reshape(self.horizon - jnp.sum(found), (1,))",
        "jnp.reshape(self.horizon - 0.9 * jnp.sum(found), (1,))",
        (f"{PARTS}::test_the_last_arc_lasts_what_the_others_leave_of_a_given_horizon",),
    ),
    "the bounds of arcs are exchanged": Planted(
        "integrators/boundary_value/arcs.py",
        "np.where(sides < 0, lower, np.where(sides > 0, upper, 0.0))",
        "np.where(sides > 0, lower, np.where(sides < 0, upper, 0.0))",
        (f"{REFINED}::test_a_switch_is_found_wherever_it_is",),
    ),
    "a control that leaves its bound smoothly jumps": Planted(
        "integrators/boundary_value/structure.py",
        "JUMP = 0.1 ",
        "JUMP = 0.0 ",
        (f"{REFINED}", f"{PARTS}::test_arcs_end_by_jumps"),
    ),
    "arcs that have vanished stay": Planted(
        "integrators/boundary_value/structure.py",
        "lasting = np.diff(self.times) > VANISHED",
        "lasting = np.diff(self.times) > -VANISHED",
        (f"{REFINED}::test_a_bound_that_becomes_inactive", f"{PARTS}::test_vanished_arcs_are_left_out"),
    ),
    "errors of controls are not squared": Planted(
        "integrators/boundary_value/step_errors.py",
        "np.max(weights[own] * apart**2, axis=1, initial=0.0)",
        "np.max(weights[own] * apart, axis=1, initial=0.0)",
        (f"{REFINED}",),
    ),
    "errors of states are relative to the states": Planted(
        "integrators/boundary_value/step_errors.py",
        "np.where(spreads > 0, spreads, 1.0), 0.0)",
        "np.where(sizes > 0, sizes, 1.0), 0.0)",
        (f"{REFINED}", f"{PARTS}::test_errors_of_steps_do_not_depend_on_the_origin"),
    ),
    "the end of a step has the limits of its beginning": Planted(
        f"{ENGINE}/transcription.py",
        "limits = jnp.concatenate([limits, *(stage.problem.node_inequalities(end) for end in (finish, begin))])",
        "limits = jnp.concatenate([limits, *(stage.problem.node_inequalities(end) for end in (begin, finish))])",
        (NODES,),
    ),
    "the ends of a step of Gauss have no pull": Planted(
        f"{ENGINE}/collocation.py",
        "return lagrangian + step[0] * pull @ limits, (*values, limits)",
        "return lagrangian, (*values, limits)",
        (NODES,),
    ),
    "covectors at the stages are those beyond a jump": Planted(
        f"{ENGINE}/transcription.py",
        "jumps = (h[0] * pull[nodes:], -h[0] * pull[:nodes]), stage.ends(y)",
        "jumps = (h[0] * pull[nodes:], h[0] * pull[:nodes]), stage.ends(y)",
        (f"{NODES}::test_the_costate_jumps_by_the_multiplier_times_the_slope",),
    ),
    "the first node is asked for where all of it is prescribed": Planted(
        "integrators/boundary_value/inequality_rows.py",
        "holds[0, -1, at_start] &= not repeated",
        "holds[0, -1, at_start] |= repeated",
        (f"{NODE_ENDS}::test_a_node_that_two_phases_share_has_its_limit_once",),
    ),
    "the time of an end counts as free": Planted(
        "integrators/boundary_value/inequality_rows.py",
        "last[-1] = first[-1]",
        "last[-1] = last[-1]",
        (f"{NODE_ENDS}::test_an_end_is_swept_across_a_ceiling_that_moves_with_the_time",),
    ),
    "multipliers of nodes are those per unit of time": Planted(
        "integrators/boundary_value/recording.py",
        "jumps = posed.conditions.data.steps[:, :, None, None] * slacks.multipliers",
        "jumps = np.ones_like(posed.conditions.data.steps)[:, :, None, None] * slacks.multipliers",
        (f"{NODES}::test_the_costate_jumps_by_the_multiplier_times_the_slope",),
    ),
    "guesses at rest are moved by what they lack": Planted(
        f"{ENGINE}/aside.py",
        "lacking = np.abs(after.gap - before.gap)[:, :-1].sum(axis=1)",
        "lacking = np.abs(after.gap)[:, :-1].sum(axis=1)",
        (RESTING,),
    ),
    "the defects of points say nothing of a guess at rest": Planted(
        f"{ENGINE}/aside.py",
        "lacking += np.abs(after.blocks.inner.defect - before.blocks.inner.defect).sum(axis=(1, 2))",
        "lacking += 0 * np.abs(after.blocks.inner.defect - before.blocks.inner.defect).sum(axis=(1, 2))",
        (RESTING,),
    ),
    "a guess through the middle of an obstacle is left": Planted(
        f"{ENGINE}/newton.py",
        "np.flatnonzero(failed & (held | violated))",
        "np.flatnonzero(failed & held)",
        (f"{TESTS}/test_inequalities.py::test_a_guess_through_the_middle_of_an_obstacle_is_led_around",),
    ),
    "a free end that is guessed is where the other one is": Planted(
        "integrators/boundary_value/end_points.py",
        "np.where(last.known, end_rows, start_rows)",
        "np.where(last.entries, end_rows, start_rows)",
        (f"{TESTS}/test_guesses.py::test_a_free_end_is_guessed_where_it_is_said",),
    ),
    "a family of extremals is left for want of a step": Planted(
        f"{ENGINE}/descent.py",
        "stays &= np.isinf(state.correction)",
        "stays &= state.correction > 0",
        (RESTING,),
    ),
    "a cost that falls less and less has no end": Planted(
        f"{ENGINE}/falling.py",
        "found[member] = far and late >= early",
        "found[member] = far",
        (NO_MINIMUM,),
    ),
    "a cost that hardly falls has no end": Planted(
        f"{ENGINE}/falling.py",
        "far = early + late > FALLEN * unit[member] and trials[-1] >= FEWEST",
        "far = trials[-1] >= FEWEST",
        (NO_MINIMUM,),
    ),
    "two constraints that hold almost the same show no minimum": Planted(
        f"{ENGINE}/augmented.py",
        "found = solved(conditions, iterate, blocks, slope, np.zeros((*assembled.gap.shape, 1)), softly=True)",
        "found = solved(conditions, iterate, blocks, slope, np.zeros((*assembled.gap.shape, 1)))",
        (f"{REFINED}::test_a_minimum_that_touches_a_cone_is_shown_with_any_accuracy",),
    ),
    "a slope that passes through zero tells how far controls go": Planted(
        f"{ENGINE}/room.py",
        "curvature = np.where(curvature > 0, np.maximum(curvature, LEAST * _largest(curvature)), curvature)",
        "pass",
        (f"{REFINED}::test_a_cone_whose_slopes_pass_through_zero_is_solved_to_any_accuracy",),
    ),
    "no horizon is to be longer": Planted(
        "integrators/boundary_value/formulated.py",
        "cheaper = pull > 0 and pull > UNMET * self._size_of_parts(solution)",
        "cheaper = False",
        (NO_MINIMUM,),
    ),
    "a horizon that grows by a small pull is not named": Planted(
        "integrators/boundary_value/formulated.py",
        "cheaper = pull > 0 and pull > UNMET * self._size_of_parts(solution)",
        "cheaper = pull > UNMET * solution.checks.hamiltonian_size",
        (f"{NO_MINIMUM}::test_a_horizon_that_grows_is_named_in_all_units",),
    ),
    "a Hamiltonian that is not finite is the fault of the steps": Planted(
        "integrators/initial_value/trajectory.py",
        "raise InvalidInputError(at_start)",
        "pass",
        (f"{TESTS}/test_trajectory.py::test_a_hamiltonian_that_is_not_finite_at_the_start_is_refused",),
    ),
}
