"""The table of manifolds and retractions: what the classes say of themselves."""

import inspect
import re

from docstrings import escaped, prose
from retrax import manifolds as m
from retrax import retractions as r
from retrax.manifolds import Manifold
from retrax.retractions import DifferentiatedRetraction, MidpointRetraction, Retraction

FAMILIES = {name: getattr(r, name) for name in ("Exponential", "Cayley", "Projection", "Polar", "QR")}
EXAMPLES: tuple[Manifold, ...] = (
    m.Euclidean(3),
    m.Sphere(2),
    m.Hyperbolic(2),
    m.Simplex(3),
    m.SO(3),
    m.SE(3),
    m.U(2),
    m.SU(2),
    m.SL(2),
    m.SPD(3),
    m.Stiefel(5, 2),
    m.ComplexStiefel(3, 2),
    m.Grassmann(5, 2),
    m.Oblique(3, 4),
    m.FixedRank(5, 4, 2),
)
OTHERS: dict[type[Manifold], tuple[type[Retraction], ...]] = {  # that no family has
    m.SE: (r.SEDecoupled,),
    m.SL: (r.FrobeniusExponential,),
    m.SPD: (r.SPDLogEuclidean, r.SPDSecondOrder),
    m.Stiefel: (r.StiefelCanonicalExponential,),
    m.FixedRank: (r.FixedRankOrthographic,),
}
HEAD = """Manifolds and retractions
=========================

``Cayley(M)`` is the retraction of that name on a manifold, ``default_retraction(M)`` the first of Exponential,
Projection, Cayley, Polar and QR that there is; products are taken factor by factor, and powers copy by copy. A level
set, and any other manifold with a ``restore``, has ``Projection`` or ``ProjectionByNewton`` by Newton's method.

Closed forms: of the inverse (i), of the domain (d), of midpoints (m), which ``Midpoint(R).inverse`` needs, and of
derivatives (D); the others are derived, by Newton's method, a round trip and automatic differentiation. The sentences
on images, those of :math:`R_x`, and on domains come from the classes; :doc:`/conformance` has the rule for all domains,
and :doc:`/benchmarks` what retractions cost.
"""


def table() -> list[str]:
    """The page: for each manifold its retractions."""
    lines = HEAD.split("\n")
    for manifold in EXAMPLES:
        members = retractions(manifold)
        title = f"{manifold}"
        lines += [title, "-" * len(title), "", ".. list-table::", "   :header-rows: 1", "   :widths: 22 66 12", ""]
        lines += row("retraction", "what it is", "closed")
        for retraction, names in members.items():
            kind = type(retraction)
            name = f":class:`~{kind.__module__.split('.')[0]}.retractions.{kind.__name__}`"
            called = f" {', '.join(names)}" if names else ""
            lines += row(name + called, words(kind), closed(retraction))
        lines.append("")
    return lines


def retractions(manifold: Manifold) -> dict[Retraction, list[str]]:
    """The retractions of a manifold, and the families that have them."""
    found: dict[Retraction, list[str]] = {}
    for name, family in FAMILIES.items():
        if family.knows(manifold):
            same = next((made for made in found if repr(made) == repr(family(manifold))), family(manifold))
            found.setdefault(same, []).append(name)
    for kind in OTHERS.get(type(manifold), ()):
        found.setdefault(kind(manifold), [])
    return found


def row(*cells: str) -> list[str]:
    """A row of a list table."""
    return [f"   {'*' if k == 0 else ' '} - {cell}" for k, cell in enumerate(cells)]


def words(kind: type[Retraction]) -> str:
    """The first sentence of a class, and those on its inverse, image and domain."""
    paragraphs = prose(inspect.cleandoc(kind.__doc__ or ""))
    sentences = re.split(r"(?<=[.;]) (?=[A-Z`])", " ".join(paragraphs[1:]))
    about = [text for text in sentences if re.search(r"\b(inverse|image|domain)\b", text, re.IGNORECASE)]
    return escaped(" ".join([paragraphs[0], *about]).rstrip(";.") + ".")


def closed(retraction: Retraction) -> str:
    """Letters for what a retraction has in closed form."""
    own = {
        "i": "preimage" in retraction.closed_forms,
        "d": "domain" in retraction.closed_forms,
        "m": isinstance(retraction, MidpointRetraction),
        "D": isinstance(retraction, DifferentiatedRetraction),
    }
    return " ".join(letter for letter, there in own.items() if there)
