"""Manifolds of pymanopt, geomstats, SciPy and jaxlie as functions of batches, for ``retractions.py``.

Each entry maps a library to what it calls its retraction and to its functions: ``retraction(x, v)``, ``inverse(x, y)``
and ``projection(x, a)``, with ambient arrays as arguments, tangent vectors too. A library without an inverse of its
retraction is measured with its exponential map and logarithm.
"""

import warnings

import jax
import numpy as np
import pymanopt.manifolds as pm
from scipy.spatial.transform import Rotation

with warnings.catch_warnings():
    warnings.simplefilter("ignore")
    import geomstats.geometry.hypersphere as gs_sphere
    import geomstats.geometry.spd_matrices as gs_spd
    import geomstats.geometry.special_orthogonal as gs_so
    import geomstats.geometry.stiefel as gs_stiefel
    import jaxlie


def one_or_many(make):
    """pymanopt's manifolds with a number of copies, made once for each batch size; one copy has no leading axis."""
    made = {}

    def call(name):
        def function(*arguments):
            count = len(arguments[0])
            manifold = made.setdefault(count, make(count))
            if count == 1:
                return getattr(manifold, name)(*(a[0] for a in arguments))[None]
            return getattr(manifold, name)(*arguments)

        return function

    return call


def pymanopt_spheres(retraction, inverse):
    """pymanopt's batch of spheres: its oblique manifold, whose columns are the points. Transposes are views."""
    made = {}

    def call(name):
        return lambda *arguments: (
            getattr(made.setdefault(len(arguments[0]), pm.Oblique(3, len(arguments[0]))), name)(
                *(a.T for a in arguments)
            ).T
        )

    functions = {"retraction": call(retraction), "inverse": call(inverse) if inverse else None}
    return retraction, functions | {"projection": call("projection")}


def transposed(x):
    """Transposes of a batch of matrices."""
    return np.swapaxes(x, -1, -2)


def pymanopt_rotations(n):
    """pymanopt's rotations, whose tangent vectors are the skew factors ``x'v``."""
    call = one_or_many(lambda k: pm.SpecialOrthogonalGroup(n, k=k))
    exponential, logarithm, skew = call("exp"), call("log"), call("projection")
    return "exponential", {
        "retraction": lambda x, v: exponential(x, transposed(x) @ v),
        "inverse": lambda x, y: x @ logarithm(x, y),
        "projection": lambda x, a: x @ skew(x, a),
    }


def pymanopt_batches(make, retraction, inverse):
    """A manifold of pymanopt that takes batches; None where it has no inverse."""
    call = one_or_many(make)
    functions = {"retraction": call(retraction), "inverse": call(inverse) if inverse else None}
    return retraction, functions | {"projection": call("projection")}


def geomstats_space(space, retraction="exp", inverse="log"):
    """A space of geomstats, whose arguments come in the opposite order."""
    forward, back = getattr(space.metric, retraction), getattr(space.metric, inverse)
    return retraction, {
        "retraction": lambda x, v: forward(v, x),
        "inverse": lambda x, y: back(y, x),
        "projection": lambda x, a: space.to_tangent(a, x),
    }


def scipy_rotations():
    """SciPy's rotation vectors, from and to matrices."""

    def vector(omega):
        return np.stack([omega[..., 2, 1], omega[..., 0, 2], omega[..., 1, 0]], axis=-1)

    def hat(w):
        return np.cross(w[..., None, :], -np.eye(3))

    return "rotation vector", {
        "retraction": lambda x, v: x @ Rotation.from_rotvec(vector(transposed(x) @ v)).as_matrix(),
        "inverse": lambda x, y: x @ hat(Rotation.from_matrix(transposed(x) @ y).as_rotvec()),
        "projection": None,
    }


def jaxlie_rotations():
    """jaxlie's rotations, compiled and batched by JAX, from and to matrices."""

    def retraction(x, v):
        omega = x.T @ v
        w = jax.numpy.array([omega[2, 1], omega[0, 2], omega[1, 0]])
        return x @ jaxlie.SO3.exp(w).as_matrix()

    def inverse(x, y):
        w = jaxlie.SO3.from_matrix(x.T @ y).log()
        return x @ jax.numpy.cross(w[None], -jax.numpy.eye(3))

    return "exponential", {
        "retraction": jax.jit(jax.vmap(retraction)),
        "inverse": jax.jit(jax.vmap(inverse)),
        "projection": None,
    }


def spd_space():
    """geomstats' positive definite matrices with the affine-invariant metric."""
    space = gs_spd.SPDMatrices(6, equip=False)
    space.equip_with_metric(gs_spd.SPDAffineMetric)
    return space


def peers(name):
    """Libraries that know the manifold of a case, each with the name of its retraction and its functions."""
    known = {
        "S2": lambda: {
            "pymanopt": pymanopt_spheres("exp", "log"),
            "pymanopt retraction": pymanopt_spheres("retraction", None),
            "geomstats": geomstats_space(gs_sphere.Hypersphere(2)),
        },
        "SO3": lambda: {
            "pymanopt": pymanopt_rotations(3),
            "geomstats": geomstats_space(gs_so.SpecialOrthogonal(3)),
            "scipy": scipy_rotations(),
            "jaxlie": jaxlie_rotations(),
        },
        "SO8": lambda: {"pymanopt": pymanopt_rotations(8), "geomstats": geomstats_space(gs_so.SpecialOrthogonal(8))},
        "St(20,5)": lambda: {
            "pymanopt": pymanopt_batches(lambda k: pm.Stiefel(20, 5, k=k), "retraction", None),
            "pymanopt polar": pymanopt_batches(
                lambda k: pm.Stiefel(20, 5, k=k, retraction="polar"), "retraction", None
            ),
            "geomstats": geomstats_space(gs_stiefel.Stiefel(20, 5), "retraction", "lifting"),
        },
        "SPD6": lambda: {
            "pymanopt": pymanopt_batches(lambda k: pm.SymmetricPositiveDefinite(6, k=k), "retraction", None),
            "pymanopt exp": pymanopt_batches(lambda k: pm.SymmetricPositiveDefinite(6, k=k), "exp", "log"),
            "geomstats": geomstats_space(spd_space()),
        },
    }
    return known[name]()


OPERATIONS = ("retraction", "inverse", "projection")
