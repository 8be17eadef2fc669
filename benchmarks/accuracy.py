"""The rest-to-rest slew to an attitude error: what each method takes for it.

    python benchmarks/accuracy.py measure [--repeats 21] [--output benchmarks/accuracy.json]
    python benchmarks/accuracy.py draw    [--input benchmarks/accuracy.json] [--output docs/attitude_error.png]
    python benchmarks/accuracy.py table   [--input benchmarks/accuracy.json]

``measure`` solves with every method in several sizes, in turns of ten calls in a row, as a controller makes them,
everything built before: the median wall time of a whole call. Every method returns a torque, polynomial on the
intervals of its mesh; its error is that of the attitude at the end when SciPy's DOP853 propagates this torque from the
start (``repropagation.py``), and all torques must have the known cost.
"""

import argparse
import json
import os
import platform
import statistics
import time
from pathlib import Path

OPTIMUM = 2504.24655710  # N^2 m^2 s
TOLERANCE = 1e-10  # relative, of every solver: the errors compared reach it
HERE = Path(__file__).parent
SIZES = {
    1: (25, 50, 100, 200, 400, 800), 2: (12, 25, 50, 100, 200), 3: (6, 8, 12, 16, 18, 25, 50),
    4: (4, 5, 6, 7, 8, 12, 16), 5: (3, 4, 5, 6, 8), 6: (3, 4, 5, 6),
}  # fmt: skip
ROW = 10  # calls
SWEEP = (12, 25, 50, 100, 200)
PANELS = (
    ("order 2, and a torque constant on a step", ("midpoint", "RK4")),
    ("order 4", ("Gauss 2", "RK4 linear", "Hermite-Simpson", "solve_bvp")),
    ("order 6", ("Gauss 3",)),
    ("order 8 to 12", ("Gauss 4", "Gauss 5", "Gauss 6")),
)
LOOKS = ("o-", "s--", "^:")  # of the lines of one solver in a panel


def cases():
    """Names, sizes and built slews of all methods."""
    from casadi_orders import OrderedSlew
    from crocoddyl_slew import CrocoddylSlew
    from pontryagin_slew import PontryaginSlew
    from retrax_slew import RetraxSlew

    for stages, sizes in SIZES.items():
        name = "midpoint" if stages == 1 else f"Gauss {stages}"
        for steps in sizes:
            yield f"retrax, {name}", steps, RetraxSlew(steps, stages, TOLERANCE)
            for solver in ("ipopt", "fatrop") if stages > 1 else ():
                yield f"{solver.upper()}, {name}", steps, OrderedSlew(name, steps, solver)
    for scheme, solver, attitude in (
        ("RK4", "ipopt", "quaternion"),
        ("RK4", "fatrop", "quaternion"),
        ("RK4 linear", "ipopt", "quaternion"),
        ("Hermite-Simpson", "ipopt", "Rodrigues"),
    ):
        for steps in SWEEP:
            yield f"{solver.upper()}, {scheme}", steps, OrderedSlew(scheme, steps, solver, attitude)
    for exponent in range(2, 10):
        yield "SciPy, solve_bvp", f"1e-{exponent}", PontryaginSlew(10.0**-exponent, 20 if exponent == 2 else 40)
    for steps in (25, 50, 100, 200, 400):
        yield "crocoddyl, RK4", steps, CrocoddylSlew(steps)


def measured(repeats):
    """A record of each case: method, size, milliseconds, attitude error, distance of the cost from the optimum."""
    from repropagation import attitude_error

    built, rows = list(cases()), []
    for name, size, slew in built:
        slew.solve()
        torque = slew.torque()
        error, excess = attitude_error(torque), torque.cost() - OPTIMUM
        rows.append({"method": name, "size": size, "attitude_error": error, "cost_excess": excess, "seconds": []})
    for _ in range(repeats):
        for row, (_, _, slew) in zip(rows, built, strict=True):
            for _ in range(ROW):
                began = time.perf_counter()
                slew.solve()
                row["seconds"].append(time.perf_counter() - began)
    for row in rows:
        seconds = row.pop("seconds")
        row |= {"median_ms": 1e3 * statistics.median(seconds), "least_ms": 1e3 * min(seconds)}
    return rows


def checked(rows):
    """The records; raises if a method has found another optimum.

    An end that is off by some angle changes the cost by 2261 N m s, the attitude's costate, times the angle; errors
    inside are larger than at the end, for which there is a factor of 50. A torque that is constant on N steps costs
    about 3700 / N^2 more.
    """
    for row in rows:
        held = row["method"].endswith("RK4")
        allowed = 50 * 2261 * row["attitude_error"] + (5000 / float(row["size"]) ** 2 if held else 1e-6)
        if not abs(row["cost_excess"]) <= allowed:
            raise RuntimeError(f"another optimum: {row}")
    return rows


def panel_of(method):
    """The panel of a method: that of the collocation with its stages, or of what is compared with it."""
    return next((place for place, (_, schemes) in enumerate(PANELS) if method.split(", ", 1)[1] in schemes))


def draw(rows, path):
    """The picture: attitude error against warm time, a panel for methods of about one order."""
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt

    colors = {"retrax": "C3", "IPOPT": "C0", "FATROP": "C2", "SciPy": "C4", "crocoddyl": "C5"}
    figure, axes = plt.subplots(2, 2, figsize=(10, 8), sharex=True, sharey=True, layout="constrained")
    lines = [dict.fromkeys(colors, 0) for _ in PANELS]
    for method in dict.fromkeys(row["method"] for row in rows):
        place, family = panel_of(method), method.split(", ")[0]
        mine = [row for row in rows if row["method"] == method]
        x, y = ([row[key] for row in mine] for key in ("median_ms", "attitude_error"))
        look = LOOKS[lines[place][family]]
        lines[place][family] += 1
        axes.flat[place].loglog(x, y, look, color=colors[family], markersize=5, label=method)
    for axis, (title, _) in zip(axes.flat, PANELS, strict=True):
        axis.set_title(title, fontsize="medium")
        axis.grid(alpha=0.3, which="major")
        axis.legend(fontsize="small")
    figure.supxlabel("warm solve, ms")
    figure.supylabel("attitude error of the propagated torque, rad")
    figure.suptitle("A 150 degree slew, rest to rest: each line from few steps to many")
    figure.savefig(path, dpi=130)


def table(rows):
    """The records as Markdown, method by method."""
    lines = ["| method | size | attitude error, rad | warm, ms | cost above the optimum |", "|---|---|---|---|---|"]
    for row in rows:
        numbers = f"{row['attitude_error']:.1e} | {row['median_ms']:.2f} | {row['cost_excess']:+.0e}"
        lines.append(f"| {row['method']} | {row['size']} | {numbers} |")
    return "\n".join(lines)


def fastest(rows, errors=(1e-4, 1e-6, 1e-8, 1e-10)):
    """For each family and error, the fastest record that reaches it, as Markdown."""
    families = list(dict.fromkeys(row["method"].split(", ")[0] for row in rows))

    def cell(family, error):
        reached = [row for row in rows if row["method"].split(", ")[0] == family and row["attitude_error"] <= error]
        if not reached:
            return "-"
        best = min(reached, key=lambda row: row["median_ms"])
        return f"{best['median_ms']:.2f} ms ({best['method'].split(', ', 1)[1]}, {best['size']})"

    lines = [f"| error below, rad | {' | '.join(families)} |", "|---" * (len(families) + 1) + "|"]
    lines += [f"| {error:.0e} | {' | '.join(cell(family, error) for family in families)} |" for error in errors]
    return "\n".join(lines)


def main():
    """Measure, draw or print."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("task", choices=["measure", "draw", "table"])
    parser.add_argument("--repeats", type=int, default=21)
    parser.add_argument("--input", type=Path, default=HERE / "accuracy.json")
    parser.add_argument("--output", type=Path)
    options = parser.parse_args()
    if options.task == "measure":
        rows = checked(measured(options.repeats))
        record = {"machine": f"{platform.machine()}, {os.cpu_count()} cores", "repeats": options.repeats, "rows": rows}
        (options.output or HERE / "accuracy.json").write_text(json.dumps(record, indent=1) + "\n")
        return
    rows = json.loads(options.input.read_text())["rows"]
    if options.task == "draw":
        draw(rows, options.output or HERE.parent / "docs" / "attitude_error.png")
    else:
        print(fastest(rows), table(rows), sep="\n\n")


if __name__ == "__main__":
    main()
