"""Settings of every test: double precision, and the seeds and examples of the property-based ones."""

import gc
import os
import random
from pathlib import Path
from zlib import crc32

import jax
import pytest
from hypothesis import HealthCheck, settings
from retrax.tracing import Tracing, resume_tracing
from retrax.undisturbed import ROOM

jax.config.update("jax_enable_x64", True)
# Most of the time of these tests is compilation: in one piece a kernel takes an eighth less, of all processors
# together, and a large one half as much without fusion emitters, as where the library compiles its own.
jax.config.update("jax_disable_most_optimizations", True)
FASTER = "--xla_cpu_parallel_codegen_split_count=1"
if jax.__version_info__ < (0, 11):  # XLA ends a process that is given an option that it does not know
    FASTER += " --xla_cpu_use_fusion_emitters=false"
os.environ["XLA_FLAGS"] = f"{os.environ.get('XLA_FLAGS', '')} {FASTER}"
# Kernels that run a few times need no places in the code for a profiler.
jax.config.update("jax_traceback_in_locations_limit", 0)
# So in the processes that tests start.
os.environ |= {"JAX_DISABLE_MOST_OPTIMIZATIONS": "1", "JAX_TRACEBACK_IN_LOCATIONS_LIMIT": "0"}
# Workers, which fill the processors, begin with this: threads of BLAS would wait for small matrices in a busy loop.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
# On few processors XLA's batched decompositions wait for one another (docs/limits.md).
os.environ.setdefault("PJRT_NPROC", "8")
os.environ["RETRAX_TRACEBACK"] = "full"  # a test that fails shows where

MEMORY_MAPS = Path("/proc/self/maps")
# Linux allows a process 65 530, compiled kernels take several each, and XLA aborts at the limit.
MOST_MEMORY_MAPS = 30_000


# Kernels that another worker or an earlier run compiled are read from the folder of pytest's cache, but the smallest
# ones: to compile those takes no longer than to read them, and to write them is added.
KERNELS = "kernels"
LEAST_SECONDS = 0.03


def pytest_addoption(parser):
    parser.addoption(
        "--part",
        help="K/M: of the slow tests the K-th of M parts, K from 0, a function's cases together; where its other cases "
        "are run by default, case by case",
    )


def pytest_configure(config):
    if hasattr(config, "cache"):
        # Processes that tests start read them from there too.
        folder = os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", str(config.cache.mkdir(KERNELS)))
        os.environ["JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS"] = str(LEAST_SECONDS)
        jax.config.update("jax_compilation_cache_dir", folder)
        jax.config.update("jax_persistent_cache_min_compile_time_secs", LEAST_SECONDS)

    config.addinivalue_line(
        "markers",
        "usual(*cases): of the cases of this test these are run by default, the others are slow; "
        "a number n: as many, from the first to the last at equal distances",
    )
    config.addinivalue_line("markers", "long(*cases): of the cases of this test these are slow")
    config.addinivalue_line("markers", "other_case: a slow case of a test of which others are run by default")


@pytest.hookimpl(wrapper=True)
def pytest_pycollect_makeitem():
    """Mark the cases of a test that are not its usual ones as slow."""
    made = yield
    for marker in made[0].iter_markers() if made and isinstance(made, list) else ():
        if marker.name in ("usual", "long"):
            named = named_cases(made, marker.args)
            for item in [item for item in made if (item in named) == (marker.name == "long")]:
                item.add_marker(pytest.mark.slow)
                item.add_marker(pytest.mark.other_case)
    return made


def named_cases(made, names):
    """The cases of a test that have these names; or as many as a number says of those that are not slow anyway."""
    if names and isinstance(names[0], int):
        (count,), fast = names, [item for item in made if not item.get_closest_marker("slow")]
        last = len(fast) - 1
        if count > last:
            raise pytest.UsageError(f"{made[0].originalname} has {len(fast)} cases, of which {count} are to be usual")
        return [fast[i * last // (count - 1)] for i in range(count)] if count > 1 else [fast[last // 2]]
    named = [item for item in made if item.callspec.id in names]
    if len(named) != len(names):
        cases = [item.callspec.id for item in made]
        raise pytest.UsageError(f"{made[0].originalname} has no cases {names}; it has {cases}")
    return named


def pytest_collection_finish():
    """What is there before the first test is not looked through for garbage again and again."""
    gc.collect()
    gc.freeze()
    gc.set_threshold(1_000_000, 20, 50)


def with_room(run, *arguments):
    """As in ``retrax.undisturbed``, outside of it: a warning names the line from which the library was entered."""
    return run(*arguments)


with_room.__code__ = with_room.__code__.replace(co_stacksize=ROOM)


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_protocol(item, nextitem):
    """Run a test as pytest does, with room for its frames."""
    runner = item.config.pluginmanager.get_plugin("runner")
    return with_room(runner.pytest_runtest_protocol, item, nextitem)


@pytest.hookimpl(trylast=True)
def pytest_unconfigure(config):
    """A worker that has told its results ends at once: to take apart all that its tests made takes seconds."""
    if hasattr(config, "workerinput"):
        os._exit(0)


# Long files, or folders of them, which would be among the last: a worker that begins one then keeps others waiting.
FIRST = {"test_changed_functions.py", "test_docs.py", "test_threads.py", "testing"}


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(config, items):
    items.sort(key=lambda item: FIRST.isdisjoint(item.path.parts))
    if part := config.getoption("part"):
        number, parts = map(int, part.split("/"))
        left = [item for item in items if item.get_closest_marker("slow") and not in_part(item, number, parts)]
        config.hook.pytest_deselected(items=left)
        items[:] = [item for item in items if item not in set(left)]


def in_part(item, number, parts):
    """Whether a slow test is in a part; cases have programs of their own, a function's cases often share one."""
    alone = item.get_closest_marker("other_case")
    name = item.nodeid if alone else item.nodeid.split("[")[0]
    return crc32(name.encode()) % parts == number % parts


@pytest.fixture(autouse=True, scope="module")
def few_memory_maps():
    """Forget the compiled kernels of earlier modules where they have become too many."""
    yield
    if MEMORY_MAPS.exists() and MEMORY_MAPS.read_bytes().count(b"\n") > MOST_MEMORY_MAPS:
        jax.clear_caches()


@pytest.fixture(scope="session")
def reading():
    """One for all modules: in another one JAX would trace its own functions anew too, as all that users call."""
    return Tracing()


@pytest.fixture(scope="module")
def traced_once(reading):
    """For modules whose functions do not change: what one call traces of them is not traced again by the next."""
    with resume_tracing(reading):
        yield


# A property's first example compiles its kernel, so examples are few, their time is unlimited and slow ones are no
# fault.
settings.register_profile(
    "local",
    max_examples=10,
    deadline=None,
    derandomize=False,
    print_blob=True,
    suppress_health_check=[HealthCheck.too_slow],
)
settings.register_profile("ci", settings.get_profile("local"), derandomize=True)
settings.load_profile("ci" if os.environ.get("CI") else "local")


@pytest.fixture(scope="session")
def seeds() -> tuple[int, ...]:
    """Seeds of the sample points of the conformance kit; its reports name the one at which a fact fails."""
    return tuple(range(5)) if os.environ.get("CI") else tuple(random.sample(range(2**31), 5))
