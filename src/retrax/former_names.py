"""Former public names, fields and modules, which work for one more release with a ``DeprecationWarning``."""

import sys
import warnings
from collections.abc import Mapping
from importlib import import_module
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec
from importlib.util import spec_from_loader
from operator import attrgetter
from types import ModuleType
from typing import Any

# The present names of modules with public classes, and classes in pickles, by the former ones.
MODULES = {
    f"retrax.{former}": f"retrax.{present}"
    for former, present in {
        "integrators.boundary_value.batch_file": "integrators.boundary_value.solution.batch",
        "integrators.boundary_value.checks": "integrators.boundary_value.solution.diagnostics",
        "integrators.boundary_value.continuation": "integrators.boundary_value.drivers.continuation",
        "integrators.boundary_value.differentiable": "integrators.boundary_value.solution.differentiable_solution",
        "integrators.boundary_value.interpolation": "integrators.boundary_value.solution.interpolation",
        "integrators.boundary_value.iteration": "integrators.boundary_value.iteration_reports",
        "integrators.boundary_value.multistart": "integrators.boundary_value.drivers.multistart",
        "integrators.boundary_value.phased_solution": "integrators.boundary_value.solution.multiphase_solution",
        "integrators.boundary_value.phases": "integrators.boundary_value.drivers.phases",
        "integrators.boundary_value.posed_phase": "integrators.boundary_value.drivers.phase_transcription",
        "integrators.boundary_value.propagation": "integrators.boundary_value.audit.discretization_error",
        "integrators.boundary_value.sensitivity": "integrators.boundary_value.solution.sensitivity",
        "integrators.boundary_value.singular_arcs": "integrators.boundary_value.audit.singular_arcs",
        "integrators.boundary_value.solution": "integrators.boundary_value.solution.record",
        "integrators.boundary_value.solutions": "integrators.boundary_value.solution.batch",
        "integrators.boundary_value.step_errors": "integrators.boundary_value.audit.step_errors",
        "integrators.boundary_value.structure": "integrators.boundary_value.audit.switching_structure",
        "integrators.boundary_conditions": "integrators.problem.boundary_conditions",
        "integrators.constraints": "integrators.problem.path_constraints",
        "integrators.free": "integrators.problem.free_quantities",
        "integrators.initial_value.many": "integrators.initial_value.batch",
        "integrators.problem": "integrators.problem.optimal_control_problem",
        "integrators.quantities": "integrators.problem.quantities",
        "integrators.reporting.results": "integrators.reporting.result_sentences",
        "integrators.results": "integrators.reporting.result_sentences",
        "integrators.stages.gauss": "integrators.stages.collocation",
        "integrators.singular.integrability.final": "integrators.singular.integrability.final_equations",
        "integrators.singular.integrability.hulls": "integrators.singular.integrability.affine_hulls",
        "integrators.singular.integrability.jets": "integrators.singular.integrability.derivative_array",
        "integrators.singular.integrability.levels": "integrators.singular.integrability.algorithm_stages",
        "integrators.singular.strategies.affine": "integrators.singular.strategies.control_affine_splitting",
        "integrators.singular.strategies.chain": "integrators.singular.strategies.goh_chain",
        "integrators.singular.strategies.direct": "integrators.singular.strategies.final_manifold_stages",
        "integrators.singular.strategies.dynamics": "integrators.singular.strategies.final_dynamics",
        "integrators.singular.strategies.leaf_factors": "integrators.singular.strategies.euclidean_part",
        "integrators.singular.strategies.project": "integrators.singular.strategies.projection",
        "integrators.singular.strategies.reduced": "integrators.singular.strategies.goh_reduced_integrator",
        "integrators.singular.strategies.reduction": "integrators.singular.strategies.goh_reduction",
        "interop.doors": "interop.adapters",
    }.items()
}


def former(module: str, names: Mapping[str, str], name: str) -> Any:
    """The object of a module that had this name.

    ``names``: the present names by the former ones. Raises ``AttributeError`` for a name that the module never had.
    """
    if name not in names:
        raise AttributeError(f"module {module!r} has no attribute {name!r}")
    warnings.warn(f"{module}.{name} is deprecated; use {names[name]}", DeprecationWarning, stacklevel=3)
    return attrgetter(names[name])(import_module(module))


def former_field(owner: str, former_name: str, name: str) -> property:
    """The property of a class that returns a field by its former name."""

    def read(instance: Any) -> Any:
        warnings.warn(f"{owner}.{former_name} is deprecated; use {name}", DeprecationWarning, stacklevel=2)
        return getattr(instance, name)

    return property(read, doc=f"The former name of ``{name}``.")


def former_module(module: str, name: str) -> Any:
    """The object of this name in a module of a former name, whose warning names the public place, if there is one."""
    present = sys.modules.get(MODULES[module])
    value = vars(present).get(name) if present else None
    if getattr(value, "__module__", None) != MODULES[module]:
        raise AttributeError(f"module {module!r} has no attribute {name!r}")
    warnings.warn(
        f"{module}.{name} is deprecated; use {_public_place(MODULES[module], name, value)}",
        DeprecationWarning,
        stacklevel=3,
    )
    return value


def _public_place(module: str, name: str, value: Any) -> str:
    """The name by which users import an object, from the outermost package that has it."""
    parts = module.split(".")
    packages = [".".join(parts[: k + 1]) for k in range(1, len(parts))]
    found = [package for package in packages if vars(sys.modules[package]).get(name) is value]
    return f"{found[0]}.{name}"


class _FormerModule(MetaPathFinder, Loader):
    """Modules by their former names, with the objects of the present modules."""

    def find_spec(self, fullname: str, path: Any = None, target: Any = None) -> ModuleSpec | None:
        """The module that runs instead of a former one; None for all other names."""
        return spec_from_loader(fullname, self) if fullname in MODULES else None

    def exec_module(self, module: ModuleType) -> None:
        """Let the names be found in the present module."""
        import_module(MODULES[module.__name__])

        def read(name: str) -> Any:
            return former_module(module.__name__, name)

        module.__dict__["__getattr__"] = read


def find_former_modules() -> None:
    """Let imports and pickles find modules by their former names."""
    sys.meta_path.append(_FormerModule())
