"""Doors to other libraries: pymanopt, geomstats, CasADi's solvers, tables, and formats of attitudes.

Manifolds go both ways. Tables are xarray, pandas and CSV files; attitudes are quaternions, splines and CCSDS
ephemerides.

None of these libraries is imported before one of these functions is called; what the import of pymanopt and geomstats
does to global settings is undone.
"""

from ..optional import MissingPackageError
from .adapters import from_geomstats, from_pymanopt, to_casadi, to_geomstats, to_pymanopt
from .attitudes import AttitudeEphemeris, from_aem, from_quaternions, to_aem, to_quaternions, to_rotation_spline
from .conventions import Conventions
from .counterpart import Counterpart
from .geometry import Geometry
from .tables import to_csv, to_pandas, to_xarray

__all__ = [
    "AttitudeEphemeris",
    "Conventions",
    "Counterpart",
    "Geometry",
    "MissingPackageError",
    "from_aem",
    "from_geomstats",
    "from_pymanopt",
    "from_quaternions",
    "to_aem",
    "to_casadi",
    "to_csv",
    "to_geomstats",
    "to_pandas",
    "to_pymanopt",
    "to_quaternions",
    "to_rotation_spline",
    "to_xarray",
]
