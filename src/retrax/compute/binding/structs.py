"""The structs of ``src/core/retrax_core.h``, and the type of the report that the core calls."""

from ctypes import CFUNCTYPE, POINTER, Structure, c_bool, c_double, c_int, c_ssize_t, c_void_p
from enum import IntEnum
from typing import final


@final
class TapeStruct(Structure):
    """``retrax_tape``."""

    _fields_ = (
        ("instructions", c_ssize_t),
        ("registers", c_ssize_t),
        ("inputs", c_ssize_t),
        ("outputs", c_ssize_t),
        ("codes", c_void_p),
        ("operands", c_void_p),
        ("values", c_void_p),
    )


@final
class TapeDataStruct(Structure):
    """``retrax_tape_data``."""

    _fields_ = (
        ("inputs", c_void_p),
        ("input_size", c_ssize_t),
        ("sources", c_void_p),
        ("outputs", c_void_p),
        ("output_size", c_ssize_t),
        ("targets", c_void_p),
    )


@final
class InertiaStruct(Structure):
    """``retrax_inertia``."""

    _fields_ = (("negative", c_ssize_t), ("smallest", c_double))


@final
class BlockSystemStruct(Structure):
    """``retrax_block_system``."""

    _fields_ = (
        ("stages", c_ssize_t),
        ("node_size", c_ssize_t),
        ("stage_size", c_ssize_t),
        ("columns", c_ssize_t),
        ("hessian", c_void_p),
        ("left", c_void_p),
        ("right", c_void_p),
        ("slope", c_void_p),
        ("defect", c_void_p),
        ("fixed_start", c_void_p),
        ("fixed_end", c_void_p),
        ("stage_scale", c_void_p),
        ("node_scale", c_void_p),
        ("cost_scale", c_double),
        ("regularisation", c_double),
        ("regularised", c_void_p),
    )


@final
class BlockSolutionStruct(Structure):
    """``retrax_block_solution``."""

    _fields_ = (
        ("step", c_void_p),
        ("multipliers", c_void_p),
        ("finite", c_void_p),
        ("largest_step", c_void_p),
        ("inertia", InertiaStruct),
        ("curvature", c_double),
        ("size", c_double),
    )


@final
class CollocationSystemStruct(Structure):
    """``retrax_collocation_system``."""

    _fields_ = (
        ("steps", c_ssize_t),
        ("points", c_ssize_t),
        ("state_size", c_ssize_t),
        ("control_size", c_ssize_t),
        ("columns", c_ssize_t),
        ("step_size", c_void_p),
        ("matrix", c_void_p),
        ("weights", c_void_p),
        ("hessian", c_void_p),
        ("jacobian", c_void_p),
        ("slope", c_void_p),
        ("defect", c_void_p),
        ("end_hessian", c_void_p),
        ("end_left", c_void_p),
        ("end_right", c_void_p),
        ("end_slope", c_void_p),
    )


@final
class CondensedSystemStruct(Structure):
    """``retrax_condensed_system``."""

    _fields_ = (
        ("hessian", c_void_p),
        ("left", c_void_p),
        ("right", c_void_p),
        ("slope", c_void_p),
        ("before", c_void_p),
        ("after", c_void_p),
        ("factors", c_void_p),
        ("swaps", c_void_p),
        ("velocities", c_void_p),
    )


@final
class FunctionStruct(Structure):
    """``retrax_function``."""

    _fields_ = (("evaluate", c_void_p), ("context", c_void_p))


@final
class TapeFunctionStruct(Structure):
    """``retrax_tape_function``."""

    _fields_ = (("tape", POINTER(TapeStruct)), ("registers", c_void_p), ("lanes", c_ssize_t), ("set", c_int))


FUNCTIONS = 10  # of a problem


@final
class ProblemStruct(Structure):
    """``retrax_problem``."""

    _fields_ = (
        ("steps", c_ssize_t),
        ("points", c_ssize_t),
        ("state_size", c_ssize_t),
        ("state_numbers", c_ssize_t),
        ("control_size", c_ssize_t),
        ("control_numbers", c_ssize_t),
        ("parameters", c_ssize_t),
        ("inequalities", c_ssize_t),
        ("node_inequalities", c_ssize_t),
        ("node_costs", c_ssize_t),
        ("matrix", c_void_p),
        ("weights", c_void_p),
        ("columns", c_void_p),
        ("arrays", c_void_p),
        ("curved_controls", c_bool),
        ("control_columns", c_void_p),
        ("control_arrays", c_void_p),
        ("never_elastic", c_void_p),
        ("bounds", c_ssize_t),
        ("coupled", c_bool),
        ("functions", FunctionStruct * FUNCTIONS),
    )


ARRAYS = 113  # of a trajectory


@final
class LayoutStruct(Structure):
    """``retrax_layout``."""

    _fields_ = (
        ("problem", POINTER(ProblemStruct)),
        ("first", c_ssize_t * ARRAYS),
        ("count", c_ssize_t * ARRAYS),
        ("numbers", c_ssize_t),
        ("sources", c_void_p * FUNCTIONS),
        ("targets", c_void_p * FUNCTIONS),
    )


@final
class LinkStruct(Structure):
    """``retrax_link``."""

    _fields_ = (("target", c_ssize_t), ("size", c_ssize_t), ("numbers", c_ssize_t))


@final
class MultiphaseStruct(Structure):
    """``retrax_multiphase``."""

    _fields_ = (
        ("phases", c_ssize_t),
        ("layouts", POINTER(POINTER(LayoutStruct))),
        ("equations", c_ssize_t),
        ("links", c_ssize_t),
        ("link", POINTER(LinkStruct)),
        ("function", FunctionStruct),
    )


@final
class ScaleStruct(Structure):
    """``retrax_scale``."""

    _fields_ = (("unknowns", c_void_p), ("nodes", c_void_p), ("cost", c_double))


@final
class Residual(IntEnum):
    """Places of the residuals of an iterate; ``retrax_core.h`` explains these."""

    DEFECT = 0
    STATIONARITY = 1
    VIOLATION = 2
    EXCESS = 3
    COMPLEMENTARITY = 4
    CENTRING = 5
    ERROR_WITHOUT_COMPLEMENTARITY = 6
    KKT_ERROR = 7
    BARRIER_ERROR = 8
    INFEASIBILITY = 9
    BARRIER_OBJECTIVE = 10
    CONSTRAINT_TERM = 11
    MAX_SCALED_DEFECT = 12


@final
class IterationStruct(Structure):
    """``retrax_iteration``."""

    _fields_ = (
        ("number", c_ssize_t),
        ("cost", c_double),
        ("defect", c_double),
        ("stationarity", c_double),
        ("regularisation", c_double),
        ("fraction", c_double),
        ("descends", c_bool),
        ("violation", c_double),
        ("barrier", c_double),
    )


REPORT = CFUNCTYPE(c_bool, c_void_p, POINTER(IterationStruct))


@final
class OptionsStruct(Structure):
    """``retrax_options``."""

    _fields_ = (
        ("tolerance", c_double),
        ("max_iterations", c_ssize_t),
        ("width", c_double),
        ("penalty_scale", c_double),
        ("detect_degenerate", c_bool),
        ("report", REPORT),
        ("context", c_void_p),
    )


@final
class SearchResultStruct(Structure):
    """``retrax_search_result``."""

    _fields_ = (
        ("trajectory", c_void_p),
        ("first", c_void_p),
        ("judging", ScaleStruct),
        ("steps", ScaleStruct),
        ("limits", c_void_p),
        ("rate", c_double),
        ("residuals", c_void_p),
        ("equations", c_void_p),
        ("values", c_void_p),
        ("jacobian", c_void_p),
        ("iterations", c_ssize_t),
        *(
            (fact, c_bool)
            for fact in (
                "iteration_limit_reached",
                "converged",
                "strict",
                "legendre_holds",
                "solvable",
                "infeasible",
                "diverging",
                "stopped",
            )
        ),
        ("inertia_correct", c_bool),
    )


@final
class FeasibilityStruct(Structure):
    """``retrax_feasibility``."""

    _fields_ = (("trials", c_ssize_t), ("feasible", c_bool), ("holds", c_bool), ("stopped", c_bool))


STEP_FUNCTIONS, STEP_ROWS = 4, 9  # functions of a method, and parts of the memory of its steps


@final
class MethodStruct(Structure):
    """``retrax_method``."""

    _fields_ = (
        ("lanes", c_ssize_t),
        ("substeps", c_ssize_t),
        ("unknowns", c_ssize_t),
        ("states", c_ssize_t),
        ("controls", c_ssize_t),
        ("rows", c_ssize_t),
        ("first", c_ssize_t * STEP_ROWS),
        ("parts", c_void_p),
        ("small_step_inverse", c_void_p),
        ("functions", FunctionStruct * STEP_FUNCTIONS),
        ("sources", c_void_p * STEP_FUNCTIONS),
        ("targets", c_void_p * STEP_FUNCTIONS),
    )


@final
class IntegrationStruct(Structure):
    """``retrax_integration``."""

    _fields_ = (
        ("trajectories", c_ssize_t),
        ("step_sizes", c_void_p),
        ("carry", c_void_p),
        ("failed", c_void_p),
        ("inverses", c_void_p),
        ("spent", c_void_p),
        ("differences", c_void_p),
        ("done", c_ssize_t),
        ("steps", c_ssize_t),
        ("phase", c_ssize_t),
        ("every", c_ssize_t),
        ("kept", c_ssize_t),
        ("record", c_void_p),
    )
