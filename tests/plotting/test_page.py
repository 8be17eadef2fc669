"""A page holds the motion that its record has, in one file that asks for nothing; in a browser it moves to what it
holds."""

import importlib.util
import json
import re
import shutil
import sys
from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest
from retrax import plotting
from retrax.integrators import OptimalControlProblem, PhasedSolution, Result, Trajectory, solve
from retrax.interop import MissingPackageError
from retrax.manifolds import SE, SO, Euclidean, InvalidInputError, Sphere, hat
from retrax.retractions import Addition, Cayley, Gauss, Midpoint
from scipy.spatial.transform import Rotation

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
NO_BROWSER = CHROMIUM is None or importlib.util.find_spec("playwright") is None
IN_A_BROWSER = pytest.mark.skipif(NO_BROWSER, reason="needs chromium of the system and the package playwright")
TURNS = Rotation.from_rotvec(np.linspace(0, 3, 31)[:, None] * [0.0, 0.6, 0.8]).as_matrix()


def poses():
    found = np.tile(np.eye(4), (31, 1, 1))
    found[:, :3, :3], found[:, :3, 3] = TURNS, np.linspace(0, 4, 31)[:, None] * [1.0, 0.2, 0.1]
    return found


def record(q, times=31):
    """A trajectory with these points and zero covectors."""
    t, q = jnp.linspace(0.0, 3.0, times), jnp.asarray(q)
    return Trajectory(t, q, 0 * q, None, t[1:], Result.successful, jnp.asarray(-1))


def data_of(path):
    """The page, and what it holds."""
    text = path.read_text(encoding="utf-8")
    (found,) = re.findall(r'<script type="application/json" id="data">(.*?)</script>', text, re.DOTALL)
    return text, json.loads(found)


PAGES = {
    "SO(3)": (TURNS, SO(3), {"rotations", "positions", "mesh", "scale", "arm", "sphere", "cones"}),
    "SE(3)": (poses(), SE(3), {"rotations", "positions", "mesh", "scale", "arm", "sphere", "balls"}),
    "S^2": (TURNS[:, :, 1], Sphere(2), {"points", "name", "unit", "sphere", "plane", "cones"}),
    "R^3": (TURNS[:, :, 1], Euclidean(3), {"points", "name", "unit", "sphere", "plane", "balls"}),
    "R^2": (TURNS[:, :2, 1], Euclidean(2), {"points", "name", "unit", "sphere", "plane", "balls"}),
    "R^5": (np.ones((31, 5)), Euclidean(5), {"balls"}),
}


@pytest.mark.parametrize("space", PAGES)
def test_a_page_holds_the_motion_in_one_file(space, tmp_path):
    values, manifold, expected = PAGES[space]
    plotting.to_html(record(values), tmp_path / "page.html", problem=manifold, title="<b>motion</b>")
    text, data = data_of(tmp_path / "page.html")
    assert set(data) == {"times", "clock", "histories", "borders"} | expected
    assert data["times"] == pytest.approx(np.linspace(0, 3, 31), rel=1e-8)
    for name, held in (("rotations", TURNS), ("points", np.pad(values.reshape(31, -1), ((0, 0), (0, 3)))[:, :3])):
        if name in data:
            np.testing.assert_allclose(data[name], held, atol=1e-8)
    assert data.get("sphere", False) == (space in ("SO(3)", "S^2"))
    assert (space == "SE(3)") == (data.get("positions") is not None)
    own = text.split("<body>")[0].split("<script>")[0] + text.split("</head>")[1]
    assert not re.search(r"https?:|src=|href=|@import|url\(", own), "nothing is asked for"
    assert "<b>motion" not in text
    assert len(text.encode()) < 6e6


def test_a_solution_is_shown_between_its_nodes_with_its_report(tmp_path):
    names = {"labels": {"controls": "</script>"}, "units": {"time": "s"}}
    problem = OptimalControlProblem(SO(3), lambda q, u: q @ hat(u), lambda q, u: u @ u / 2, 3, **names)
    solution = solve(problem, np.eye(3), TURNS[8], 2.0, method=Midpoint(Cayley(SO(3))), steps=3)
    solution.to_html(tmp_path / "page.html", mesh=([[0, 0, 0], [2.0, 0, 0], [0, 1, 0]], [[0, 1, 2]]))
    text, data = data_of(tmp_path / "page.html")
    times = np.array(data["times"])
    assert len(times) > 100
    np.testing.assert_allclose(data["rotations"], solution(np.clip(times, 0, 2)).states, atol=1e-8)
    attitude, rate = data["histories"]
    assert (attitude["held"], rate["held"]) == (False, True)
    np.testing.assert_allclose(np.array(rate["columns"])[:, :-1], solution.controls.T, atol=1e-8)
    np.testing.assert_allclose(rate["times"], solution.times, atol=1e-8)
    between = np.clip(attitude["times"], 0, 2)
    assert len(between) > 400
    vectors = Rotation.from_matrix(solution(between).states).as_rotvec()
    np.testing.assert_allclose(np.transpose(attitude["columns"]), vectors, atol=1e-8)
    assert data["histories"][1]["title"] == "</script>"
    assert data["clock"] == "time [s]"
    assert "strict local minimum" in text
    assert data["mesh"] == {"vertices": [[0, 0, 0], [2, 0, 0], [0, 1, 0]], "faces": [[0, 1, 2]]}
    assert 2 * data["scale"] < 1, "the body is inside the sphere"


def test_nothing_is_uploaded(tmp_path):
    """The button of Plotly that sends a chart to its servers is off, in every drawing of the page."""
    plotting.to_html(record(TURNS), tmp_path / "page.html", problem=SO(3))
    script = data_of(tmp_path / "page.html")[0].split("</head>")[1]
    assert re.findall(r"showSendToCloud: (\w+)", script) == ["false"]
    (options,) = re.findall(r"options = (\{[^}]*\})", script)
    assert "showSendToCloud" in options
    newly = re.findall(r"Plotly\.newPlot\((?:[^()]|\([^()]*\))*?(\w+)\)", script)
    assert len(newly) == script.count("Plotly.newPlot(") == 2
    assert set(newly) == {"options"}


def test_histories_are_in_degrees_and_have_bounds_where_they_are_asked_for(tmp_path):
    plane = Euclidean(1)
    rates = {"units": {"controls": "rad/s", "time": "s"}, "labels": {"controls": "rate"}}
    problem = OptimalControlProblem(plane, lambda q, u: u, lambda q, u: u @ u, 1, control_bounds=(-2.0, 1.5), **rates)
    solution = solve(problem, 0.0, 1.0, 1.0, method=Gauss(2, Addition(plane)), steps=4)
    for degrees, factor, unit in ((False, 1.0, "rad/s"), (True, 180 / np.pi, "deg/s")):
        solution.to_html(tmp_path / "page.html", degrees=degrees)
        rate = data_of(tmp_path / "page.html")[1]["histories"][1]
        assert rate["title"] == f"rate [{unit}]"
        assert rate["bounds"] == pytest.approx([-2.0 * factor, 1.5 * factor])
        np.testing.assert_allclose(rate["columns"], factor * np.ones((1, len(rate["times"]))), rtol=1e-7)


def test_cones_and_obstacles_are_in_the_scene(tmp_path):
    file = tmp_path / "page.html"
    for space in ("SO(3)", "S^2"):
        plotting.to_html(record(PAGES[space][0]), file, problem=PAGES[space][1], cones=[([0, 3.0, 4.0], 0.5)])
        (rim,) = data_of(file)[1]["cones"]
        np.testing.assert_allclose(np.array(rim) @ [0, 0.6, 0.8], np.cos(0.5), atol=1e-8)
        np.testing.assert_allclose(np.linalg.norm(rim, axis=1), 1, atol=1e-8)
    for space, n in (("R^2", 2), ("R^3", 3), ("SE(3)", 3)):
        centre = [1.0, 2.0, 3.0][:n]
        plotting.to_html(record(PAGES[space][0]), file, problem=PAGES[space][1], obstacles=[(centre, 0.5)])
        assert data_of(file)[1]["balls"] == [[[*centre, 0.0][:3], 0.5]]
        with pytest.raises(InvalidInputError, match="obstacles must be pairs"):
            plotting.to_html(record(PAGES[space][0]), file, problem=PAGES[space][1], obstacles=[([1.0], 0.5)])


def test_phases_are_one_motion(tmp_path):
    problem = OptimalControlProblem(SO(3), lambda q, u: q @ hat(u), lambda q, u: u @ u / 2, 3)
    first = solve(problem, np.eye(3), TURNS[8], 2.0, method=Midpoint(Cayley(SO(3))), steps=3)
    second = replace(first, times=3 * first.times, stage_times=3 * first.stage_times)
    phased = PhasedSolution.of([first, second], {})
    plotting.to_html(phased, tmp_path / "page.html")
    data = data_of(tmp_path / "page.html")[1]
    assert data["borders"] == pytest.approx([2.0])
    assert data["times"][-1] == pytest.approx(8.0)
    assert len(data["times"]) == len(data["rotations"])
    steps = np.diff(data["times"])
    assert np.max(steps) < 1.1 * np.median(steps), "of the same speed everywhere"
    for k in (20, len(steps) // 2, len(steps)):
        t = data["times"][k]
        np.testing.assert_allclose(data["rotations"][k], phased.phases[int(t > 2)](min(t, 8.0)).states, atol=1e-7)
    assert len(data["histories"]) == 2


@pytest.mark.parametrize(
    "mesh",
    [
        1,
        ([[0, 0, 0]],),
        ([[0, 0]], [[0, 0, 0]]),
        ([[0, 0, 0]], [[0, 0, 1]]),
        ([[0, 0, np.nan]], [[0, 0, 0]]),
        ([[0, 0, 0]], [[0.0, 0, 0]]),
    ],
    ids=repr,
)
def test_other_meshes_are_refused(mesh, tmp_path):
    with pytest.raises(InvalidInputError, match="mesh must be"):
        plotting.to_html(record(TURNS), tmp_path / "page.html", mesh, problem=SO(3))
    assert not (tmp_path / "page.html").exists()


def test_the_package_that_draws_is_named_where_it_is_missing(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "plotly.offline", None)
    with pytest.raises(MissingPackageError, match="pip install plotly"):
        plotting.to_html(record(TURNS), tmp_path / "page.html", problem=SO(3))


@pytest.fixture(scope="module")
def browser():
    """Chromium without a window."""
    from playwright.sync_api import sync_playwright

    software = ["--no-sandbox", "--use-gl=swiftshader", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist"]
    with sync_playwright() as driver:
        opened = driver.chromium.launch(executable_path=CHROMIUM, args=software)
        yield opened
        opened.close()


def difference(one, other):
    """The share of pixels that differ between two pictures in PNG."""
    from io import BytesIO

    from matplotlib import image

    a, b = (image.imread(BytesIO(content))[..., :3] for content in (one, other))
    return np.mean(np.max(np.abs(a - b), axis=2) > 0.1)


@pytest.mark.slow
@IN_A_BROWSER
@pytest.mark.parametrize("space", ["SO(3)", "SE(3)", "S^2", "R^5"])
def test_in_a_browser_the_slider_moves_the_body_and_play_goes_on(space, browser, tmp_path):
    values, manifold, _ = PAGES[space]
    plotting.to_html(record(values), tmp_path / "page.html", problem=manifold)
    page, wrong = browser.new_page(), []
    page.on("console", lambda message: wrong.append(message.text) if message.type == "error" else None)
    page.on("pageerror", lambda error: wrong.append(str(error)))
    page.on("request", lambda request: wrong.append(request.url) if not request.url.startswith("file:") else None)
    page.goto((tmp_path / "page.html").as_uri())
    page.wait_for_selector("body[data-ready=true]", timeout=60_000)
    pictures = {}
    for frame in (0, 20, 0):
        page.fill("#time", str(frame))
        assert float(page.evaluate("document.body.dataset.time")) == pytest.approx(0.1 * frame)
        if space in ("SO(3)", "SE(3)"):
            vertices, scale = page.evaluate("[retrax.data.mesh.vertices, retrax.data.scale]")
            drawn = page.evaluate("(() => { const m = retrax.drawn(0); return [m.x, m.y, m.z]; })()")
            expected = scale * np.array(vertices) @ TURNS[frame].T + (values[frame, :3, 3] if space == "SE(3)" else 0)
            np.testing.assert_allclose(np.array(drawn).T, expected, atol=1e-7)
        elif space == "S^2":
            drawn = page.evaluate("(() => { const m = retrax.drawn(0); return [m.x[0], m.y[0], m.z[0]]; })()")
            np.testing.assert_allclose(drawn, values[frame], atol=1e-7)
        page.wait_for_timeout(500)
        taken = page.screenshot()
        if frame in pictures:
            assert difference(taken, pictures[frame]) < 1e-3
        pictures[frame] = taken
    assert difference(pictures[0], pictures[20]) > 1e-3
    page.click("#play")
    page.wait_for_function("Number(document.body.dataset.time) > 0.2", timeout=30_000)
    page.click("#play")
    paused = page.evaluate("document.body.dataset.time")
    page.wait_for_timeout(300)
    assert page.evaluate("document.body.dataset.time") == paused
    assert wrong == []
    page.close()


@pytest.mark.slow
@IN_A_BROWSER
@pytest.mark.parametrize("width", [340, 500, 1200])
def test_in_a_browser_the_page_shows_the_values_at_its_time_on_every_width(width, browser, tmp_path):
    plotting.to_html(record(TURNS), tmp_path / "page.html", problem=SO(3))
    page = browser.new_page(viewport={"width": width, "height": 800})
    page.goto((tmp_path / "page.html").as_uri())
    page.wait_for_selector("body[data-ready=true]", timeout=60_000)
    page.fill("#time", "20")
    page.wait_for_selector("#histories .hoverlayer .legend", timeout=30_000)
    told = page.text_content("#histories .hoverlayer").replace("\N{MINUS SIGN}", "-")
    values = [float(found) for found in re.findall(r"q, rotation vector [xyz]: (-?[\d.]+)", told)]
    assert values == pytest.approx(Rotation.from_matrix(TURNS[20]).as_rotvec(), abs=1e-4)
    titles = page.evaluate("[...document.querySelectorAll('[data-title]')].map(button => button.dataset.title)")
    assert titles
    assert not any("hare" in title or "loud" in title for title in titles)
    assert page.evaluate("document.documentElement.scrollWidth") <= width, "nothing is cut off at the right"
    boxes = page.evaluate(
        "['scene', 'histories'].map(id => { const b = document.getElementById(id).getBoundingClientRect();"
        " return [b.left, b.right, b.top, b.bottom]; })"
    )
    assert (boxes[1][2] >= boxes[0][3]) == (width < 800), "below each other on a narrow screen"
    page.close()


@pytest.mark.slow
@IN_A_BROWSER
def test_a_page_of_a_solution_is_ready_within_two_seconds(browser, tmp_path):
    """Of the processor, and without a graphics card: a clock on the wall would measure the neighbours too."""
    problem = OptimalControlProblem(SO(3), lambda q, u: q @ hat(u), lambda q, u: u @ u / 2, 3)
    solve(problem, np.eye(3), TURNS[8], 2.0, method=Midpoint(Cayley(SO(3))), steps=50).to_html(tmp_path / "page.html")
    page = browser.new_page()
    session = page.context.new_cdp_session(page)
    session.send("Performance.enable", {"timeDomain": "threadTicks"})
    page.goto((tmp_path / "page.html").as_uri())
    page.wait_for_selector("body[data-ready=true]", timeout=60_000)
    measured = {entry["name"]: entry["value"] for entry in session.send("Performance.getMetrics")["metrics"]}
    assert 0.1 < measured["ThreadTime"] < 2
    page.close()
