"""A system with an integrator that its user holds: traced once, then integrated from many starts."""

from typing import Any, final
from weakref import finalize

from jaxtyping import Array, ArrayLike

from ...compute.closure_guard import ClosureGuard
from ...compute.jit_cache import digest
from ...manifolds.numerics.ambient import Ambient
from ...tracing import Tracing, resume_tracing
from ..problem.user_functions import require_concrete
from .batch import integrate_many
from .integrate import check_call, integrate
from .integrator import Integrator
from .trajectory import Trajectory


@final
class Flow:
    """A system with an integrator, traced once, so that each ``integrate`` takes little more than its steps.

    Parameters
    ----------
    system, integrator, evaluator
        As in ``retrax.integrators.integrate``, with equal trajectories.

    Raises
    ------
    InvalidInputError
        For other arguments, in a call that JAX transforms, and for a new trace after the functions have changed.

    Notes
    -----
    The first call traces the functions and freezes the values that they use; for other values build another flow.

    Examples
    --------
    >>> flow = Flow(lambda q, p: (p @ p + q @ q) / 2, SymplecticIntegrator(Gauss(2, Exponential(Euclidean(1)))))
    >>> [float(flow.integrate((np.ones(1), np.zeros(1)), h, 10).q[-1, 0].round(4)) for h in (0.1, 0.2)]
    [0.5403, -0.4161]
    """

    def __init__(self, system: Any, integrator: Integrator, evaluator: str = "automatic") -> None:
        check_call(integrator, 1, 1, evaluator)
        require_concrete("Flow", system, integrator)
        self.system, self.integrator = system, integrator
        self._unchanged = ClosureGuard("Flow", self._digest)
        self._evaluator, self._reading = evaluator, Tracing()
        finalize(self, self._reading.end)

    def _digest(self) -> bytes | None:
        """A digest of what the functions of the system compute now."""
        if hasattr(self.system, "_digest"):
            return self.system._digest()
        ambient = self.integrator.manifold.ambient
        return digest(self.system, ambient, ambient)

    def __repr__(self) -> str:
        return f"Flow({type(self.integrator).__name__} on {self.integrator.manifold})"

    def integrate(
        self,
        start: tuple[Ambient, Ambient],
        step_size: float | Array,
        steps: int,
        save_every: int = 1,
        throw: bool = True,
        verbose: bool = False,
    ) -> Trajectory:
        """The trajectory from one start, as ``retrax.integrators.integrate`` returns it.

        Parameters
        ----------
        start, step_size, steps, save_every, throw, verbose
            As in ``retrax.integrators.integrate``.

        Examples
        --------
        >>> str(Flow(lambda q, p: p @ p / 2, SymplecticIntegrator(Gauss(1, Cayley(SO(3))))))
        'Flow(SymplecticIntegrator on SO(3))'
        """
        require_concrete("Flow.integrate", start, step_size)
        with resume_tracing(self._reading), self._unchanged.guard():
            return integrate(
                self.system, self.integrator, start, step_size, steps, save_every, throw, self._evaluator, verbose
            )

    def integrate_many(
        self,
        starts: tuple[Ambient, Ambient],
        step_sizes: ArrayLike,
        steps: int,
        save_every: int = 1,
        verbose: bool = False,
    ) -> Trajectory:
        """The trajectories from many starts, as ``retrax.integrators.integrate_many`` returns them.

        Parameters
        ----------
        starts, step_sizes, steps, save_every, verbose
            As in ``retrax.integrators.integrate_many``.

        Examples
        --------
        >>> Flow.integrate_many.__name__
        'integrate_many'
        """
        with resume_tracing(self._reading), self._unchanged.guard():
            return integrate_many(
                self.system, self.integrator, starts, step_sizes, steps, save_every, self._evaluator, verbose
            )
