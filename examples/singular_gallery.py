r"""Gallery of singular problems

A gallery of singular problems: what the integrability algorithm finds, beside what is known, and the motion on
:math:`P_f`.

- Aly and Chan's problem: on :math:`P_f` an oscillator, :math:`u = -\sin t` from (0, 1), cost 0 at :math:`\pi/2`.
- Chains of :math:`n` integrators: :math:`P_f` is the origin, after :math:`2n` levels.
- A charged particle without mass, :math:`p = A(q)`: two primary equations of second class; it drifts along the level
  lines of its potential energy, :math:`\dot q = (-2y, x)/\operatorname{curl} A`.
- Brown's Lagrangian of four degrees of freedom: all four classes of equations. The difference :math:`d = q_4 - q_2`
  is an oscillator, whatever the gauge control is.
- :math:`H = p_1 x_2 + p_2 u`: :math:`P_f = \{p = 0\}` with zero form, so that the control is free: every motion with
  :math:`\dot x_1 = x_2` is an extremal.
- Two problems without extremals.

    python examples/singular_gallery.py [--only aly-chan brown] [--steps 120] [--output examples/output]
"""

import argparse
from pathlib import Path

import jax
import jax.numpy as jnp
import matplotlib as mpl
import numpy as np
from retrax.integrators import integrate
from retrax.integrators.singular import classify, singular_integrator
from retrax.problems import SINGULAR
from retrax.retractions import Midpoint, default_retraction

jax.config.update("jax_enable_x64", True)
mpl.use("Agg")
import matplotlib.pyplot as plt

CHAINS = ("chain of 2", "chain of 3", "chain of 4")
EMPTY = ("linear cost", "unpaid control")
ROW = "{:18s} {:>6s} {:>6s} {:>9s} {:>6s}  {}"


def outcome(record):
    """Dimension of P_f, rank of its form, levels, and number of gauge controls; None where P_f is empty."""
    return (
        None if record.empty else (record.dimension, record.rank, (record.k_f, record.k_f_base), record.gauge_controls)
    )


def known_outcome(known):
    """The same from the library of problems."""
    return None if known.empty_at is not None else (known.dimension, known.rank, known.levels, known.gauge)


def report(name, known, record):
    """Print a row of the table; whether the algorithm found what is known."""
    found = outcome(record)
    agrees = found == known_outcome(known) and (found or len(record.levels) - 1 == known.empty_at)
    if found is None:
        words = ["empty", "", f"at {len(record.levels) - 1}", ""]
    else:
        dimension, rank, (k_f, base), gauge = found
        words = [str(dimension), str(rank), f"{k_f} (P {base})", str(gauge)]
    print(ROW.format(name, *words, "as known" if agrees else f"known: {known_outcome(known)}, {known.empty_at}"))
    return bool(agrees)


def integrated(record, start, time, steps, gauge=None):
    """The trajectory on P_f from a point of it, by the strategy that the classification chooses."""
    method, choice = singular_integrator(record, Midpoint(default_retraction(record.problem.manifold)), gauge=gauge)
    print(f"    {choice}")
    return integrate(record.problem, method, start, time / steps, steps)


def aly_chan(record, steps, axis):
    """The error of the control against its closed form, and the cost."""
    path = integrated(record, (jnp.array([0.0, 1.0]), jnp.array([1.0, 0.0])), np.pi / 2, steps)
    t, u = np.asarray(path.stage_times), np.asarray(path.controls)[:, 0]
    axis.plot(path.times, path.q, label=["x1", "x2"])
    axis.plot(t, u, label="u")
    axis.plot(t, -np.sin(t), "k:", label="-sin t")
    axis.set(title="Aly-Chan", xlabel="t")
    axis.legend()
    cost = np.trapezoid((path.q[:, 1] ** 2 - path.q[:, 0] ** 2) / 2, path.times)
    return {"control error": float(np.max(np.abs(u + np.sin(t)))), "cost": abs(float(cost))}


def massless_particle(record, steps, axis):
    """The variation of the potential energy along a drift around the origin, and how far p = A(q) is missed."""
    path = integrated(record, (jnp.array([0.6, 0.0]), jnp.array([0.0, 0.6 * (1 + 0.36) / 2])), 8.0, steps)
    x, y = np.asarray(path.q).T
    potential, angle = x**2 / 2 + y**2, np.linspace(0, 2 * np.pi, 200)
    missed = np.asarray(path.p) - ((1 + x**2 + y**2) / 2 * np.stack([-y, x])).T
    axis.plot(x, y, ".", label="nodes")
    axis.plot(0.6 * np.cos(angle), 0.6 / np.sqrt(2) * np.sin(angle), "k:", label="level line of the energy")
    axis.set(title="massless particle", xlabel="x", ylabel="y", aspect="equal")
    axis.legend()
    return {"energy variation": float(np.ptp(potential)), "distance from P_f": float(np.max(np.abs(missed)))}


def brown(record, steps, axis):
    """With two gauge controls, the error of ``d = q4 - q2`` against ``cos t`` and how much of the gauge it sees."""
    start, ends = (jnp.array([-1.0, 0.0, 0.0, 1.0]), jnp.zeros(4)), []
    for name, gauge in {"0": lambda t, q, p: jnp.zeros(1), "cos 3t": lambda t, q, p: jnp.cos(3 * t)[None]}.items():
        path = integrated(record, start, 2 * np.pi, steps, gauge)
        ends.append(np.asarray(path.q[:, 3] - path.q[:, 1]))
        axis.plot(path.times, path.q[:, 1], "--", label=f"q2, gauge control {name}")
        axis.plot(path.times, ends[-1], label=f"q4 - q2, gauge control {name}", linewidth=6 / len(ends) ** 2)
    axis.set(title="Brown", xlabel="t", ylim=(-1.15, 1.75))
    axis.legend(loc="upper center", fontsize="small", ncols=2)
    errors = [np.max(np.abs(end - np.cos(path.times))) for end in ends]
    return {"error of q4 - q2": float(max(errors)), "seen of the gauge": float(np.max(np.abs(ends[0] - ends[1])))}


def gauge(record, steps, axis):
    """The error of ``x1 = 1 - cos t`` with the gauge control ``cos t``, and of ``p = 0``."""
    path = integrated(record, (jnp.zeros(2), jnp.zeros(2)), 2 * np.pi, steps, lambda t, q, p: jnp.cos(t)[None])
    axis.plot(path.times, path.q, label=["x1", "x2"])
    axis.plot(path.times, 1 - np.cos(path.times), "k:", label="1 - cos t")
    axis.set(title="p1 x2 + p2 u with u = cos t", xlabel="t")
    axis.legend()
    errors = path.q[:, 0] - (1 - np.cos(path.times)), path.p
    return {"error of x1": float(np.max(np.abs(errors[0]))), "p": float(np.max(np.abs(errors[1])))}


MOTIONS = {"aly-chan": aly_chan, "massless particle": massless_particle, "brown": brown, "gauge": gauge}
NAMES = (*MOTIONS, *CHAINS, *EMPTY)


def main(arguments=None):
    """Classify, compare, integrate, plot; returns whether each outcome is the known one, and the numbers of each
    motion."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("--only", nargs="+", choices=NAMES, default=NAMES, metavar="PROBLEM", help=", ".join(NAMES))
    parser.add_argument("--steps", type=int, default=120, help="number of steps of each motion")
    parser.add_argument("--output", type=Path, default=Path(__file__).parent / "output", help="folder of the figures")
    options = parser.parse_args(arguments)
    options.output.mkdir(parents=True, exist_ok=True)

    figure, axes = plt.subplots(2, 2, figsize=(11, 8), layout="constrained")
    panels, agree, numbers = dict(zip(MOTIONS, axes.flat, strict=True)), {}, {}
    print(ROW.format("problem", "dim", "rank", "levels", "gauge", ""))
    for name in options.only:
        known = SINGULAR[name]()
        record = classify(known.problem)
        agree[name] = report(name, known, record)
        if name in MOTIONS:
            numbers[name] = MOTIONS[name](record, options.steps, panels[name])
            print("    " + ", ".join(f"{what} {value:.1e}" for what, value in numbers[name].items()))
    for name in set(MOTIONS) - set(options.only):
        panels[name].set_visible(False)
    path = options.output / "singular_gallery.png"
    figure.savefig(path, dpi=150)
    plt.close(figure)
    print(f"written: {path}")
    return agree, numbers


if __name__ == "__main__":
    main()
