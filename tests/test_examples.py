"""Every example runs and reaches the numbers that it prints."""

import importlib.util
from pathlib import Path

import numpy as np
import pytest

EXAMPLES = Path(__file__).parents[1] / "examples"


def example(name):
    """The module of an example script."""
    spec = importlib.util.spec_from_file_location(name, EXAMPLES / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_attitude_slew(tmp_path, capsys):
    module = example("attitude_slew")
    solution = module.main(["--steps", "20", "--output", str(tmp_path)])
    assert solution.checks.strict_minimum
    assert solution.checks.manifold_violation <= 1e-13
    assert abs(solution.cost / module.REFERENCE_COST - 1) <= 1e-11
    assert {path.suffix for path in tmp_path.iterdir()} == {".png", ".npz"}
    assert "loads back unchanged: True" in capsys.readouterr().out


def test_spherical_pendulum(tmp_path):
    errors, momentum = example("spherical_pendulum").main(["--steps", "20000", "--output", str(tmp_path)])
    ours, other = errors.values()
    half = len(ours) // 2
    assert momentum <= 1e-12
    assert np.max(np.abs(ours[half:])) <= 1.05 * np.max(np.abs(ours[:half])), "the energy error does not grow"
    assert np.max(np.abs(other[half:])) >= 1.5 * np.max(np.abs(other[:half])), "that of the other method does"
    assert (tmp_path / "spherical_pendulum_energy.png").exists()


@pytest.mark.slow
def test_path_planning(tmp_path):
    module = example("path_planning")
    solution, distance, length, error = module.main(["--steps", "20", "--output", str(tmp_path)])
    assert solution.checks.strict_minimum
    assert error <= 1e-10, "the energy of the geodesic"
    assert distance >= module.RADIUS
    assert 1 <= length / module.taut_string() <= 1.05
    assert (tmp_path / "path_planning.png").exists()


@pytest.mark.slow
def test_monte_carlo_slew(tmp_path, capsys):
    module = example("monte_carlo_slew")
    found, deviation, linear = module.main(["--samples", "1000", "--output", str(tmp_path)])
    assert found.complete
    assert found.converged == found.kept["minimum"].sum() == 1000
    # The sample deviation of 1000 is known to 1 / sqrt(2000), and a part in a hundred is not linear: three and a half
    # of these.
    assert deviation == pytest.approx(linear, rel=0.08)
    assert "nothing was solved again: True" in capsys.readouterr().out
    assert (tmp_path / "monte_carlo_slew.png").exists()


@pytest.mark.slow
def test_open_loop_slew(tmp_path):
    deviations, linear, mean_log = example("open_loop_slew").main(["--samples", "500", "--output", str(tmp_path)])
    assert mean_log <= 1e-10, "the mean of the logarithms vanishes at the Fréchet mean"
    np.testing.assert_allclose(deviations, linear, rtol=0.1)
    assert (tmp_path / "open_loop_slew.png").exists()


@pytest.mark.slow
def test_own_manifold(tmp_path, capsys):
    errors = example("own_manifold").main(["--steps", "20", "--output", str(tmp_path)])
    # Of order 2: at 20 steps 6 times as far from the optimum as at 50.
    assert 0 < errors["torus"] < 1e-3
    assert 0 < errors["ellipsoid"] < 2e-3
    assert 0 < errors["Heisenberg group"] < 1e-2
    assert " fails " not in capsys.readouterr().out
    assert (tmp_path / "own_manifold.png").exists()


@pytest.mark.slow
def test_abnormal_extremals(tmp_path):
    module = example("abnormal_extremals")
    (exact, numeric), line, errors, (straight, departures), heights = module.main(
        ["--front", "8", "--output", str(tmp_path)]
    )
    for found in exact:
        pieces = [(len(piece.coordinates), len(piece.kernel), piece.k_f, len(piece.controls)) for piece in found.strata]
        # Dimension, kernel of the form, level, determined controls: at rest, and the abnormal lines.
        assert pieces == [(4, 0, 1, 2), (3, 1, 2, 1)]
    for found in numeric:
        assert found.irregular, "the two pieces cross, and the record says so"
        assert [(6 - s.signature.codimension, s.signature.free_controls) for s in found.strata] == [(4, 0), (3, 1)]
    np.testing.assert_allclose(line, np.linspace(0, 1, 11)[:, None] * [0, 1, 0], atol=1e-14)
    for order in (2, 4):
        assert abs(np.log2(errors[order, 100] / errors[order, 200]) - order) <= 0.05
    assert errors[4, 200] <= 2e-7, "against Jacobi's elliptic functions"
    assert np.all(straight[..., 0] == 0), "the line is a normal extremal in the flat metric"
    np.testing.assert_allclose(departures, 2 * module.EPSILON, rtol=1e-3)
    assert np.all(heights > 0.333), "no other flat geodesic joins two points of the line"
    assert (tmp_path / "abnormal_extremals.png").exists()


@pytest.mark.slow
def test_singular_sphere(tmp_path):
    module = example("singular_sphere")
    defects, gaps, drifts = module.main(["--steps", "100000", "--output", str(tmp_path)])
    assert gaps["rattle"] <= 1e-14
    assert max(defects["rattle"]) <= 1e-13, "RATTLE preserves the form"
    slope, _ = np.polyfit(np.log(module.SIZES), np.log(defects["project"]), 1)
    assert slope == pytest.approx(3, abs=0.2), "the projection does not"
    standard_errors = {name: abs(slope) / error for name, (slope, error) in drifts.items()}
    assert standard_errors["rattle"] <= 2, "its energy does not drift"
    assert standard_errors["project"] >= 10, "that of the projection does"
    assert (tmp_path / "singular_sphere.png").exists()


@pytest.mark.slow
def test_academic_singular(tmp_path):
    classification, errors, differences = example("academic_singular").main(["--output", str(tmp_path)])
    assert (classification.dimension, classification.rank, classification.gauge_controls) == (3, 2, 1)
    assert max(differences.values()) <= 1e-14, "the scheme that the paper prints"
    for name, error in errors.items():
        np.testing.assert_allclose(error[:-1] / error[1:], 4, atol=0.15, err_msg=name)
        assert error[-1] <= 2e-5
    assert (tmp_path / "academic_singular.png").exists()


@pytest.mark.slow
def test_rolling_ball(tmp_path):
    turntable, incline, (energy, momentum), slip = example("rolling_ball").main(
        ["--steps", "1000", "--output", str(tmp_path)]
    )
    coarse, fine, centre, force, moving = turntable
    assert (4 * fine - coarse) / 3 == pytest.approx(2 / 7, rel=1e-6)
    assert 7 / 2 * coarse - 1 == pytest.approx(4 * (7 / 2 * fine - 1), rel=0.02), "of order 2"
    assert centre <= 1e-12
    assert max(force, moving) <= 4e-4
    assert incline[0] == pytest.approx(5 / 7, abs=1e-12)
    assert incline[1] <= 5e-4
    assert momentum <= 1e-12, "three symmetries whose generators satisfy the constraints"
    assert max(energy[2:]) <= 1.1 * max(energy[:2]) <= 2e-5, "no drift"
    assert slip <= 1e-14
    assert (tmp_path / "rolling_ball.png").exists()


@pytest.mark.slow
def test_singular_gallery(tmp_path):
    agree, numbers = example("singular_gallery").main(["--output", str(tmp_path)])
    assert len(agree) == 9
    assert all(agree.values()), "what the algorithm finds is what is known"
    # Of order 2 at 120 steps; the two zeros to rounding.
    assert all(value <= 5e-5 for value in numbers["aly-chan"].values())
    assert all(value <= 3e-4 for value in numbers["massless particle"].values())
    assert numbers["brown"]["error of q4 - q2"] <= 2e-3
    assert numbers["brown"]["seen of the gauge"] <= 1e-13
    assert numbers["gauge"]["error of x1"] <= 5e-4
    assert numbers["gauge"]["p"] <= 1e-14
    assert (tmp_path / "singular_gallery.png").exists()


@pytest.mark.slow
def test_singular_attitude(tmp_path):
    found = example("singular_attitude").main(["--output", str(tmp_path)])
    facts = {name: (c.dimension, c.rank, c.k_f, c.second_class, c.gauge_controls) for name, (c, *_) in found.items()}
    assert facts == {"free actuator": (10, 10, 2, 2, 0), "failed actuator": (8, 8, 2, 4, 0)}
    for name, (_, numbers, _, _) in found.items():
        assert numbers["P_f"] <= 1e-14, name
        assert max(numbers["omega_f"]) <= 1e-13, name
        assert numbers["momentum"] <= 1e-12, name
        coarse, fine = numbers["energy"]
        assert np.log2(coarse / fine) == pytest.approx(2, abs=0.05), name
    assert (tmp_path / "singular_attitude.png").exists()
