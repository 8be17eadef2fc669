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
    "SO(3)": (TURNS, SO(3), {"motions", "mesh", "scale", "arm", "sphere", "cones"}),
    "SE(3)": (poses(), SE(3), {"motions", "mesh", "scale", "arm", "sphere", "balls"}),
    "S^2": (TURNS[:, :, 1], Sphere(2), {"motions", "name", "unit", "sphere", "plane", "cones"}),
    "R^3": (TURNS[:, :, 1], Euclidean(3), {"motions", "name", "unit", "sphere", "plane", "balls"}),
    "R^2": (TURNS[:, :2, 1], Euclidean(2), {"motions", "name", "unit", "sphere", "plane", "balls"}),
    "R^5": (np.ones((31, 5)), Euclidean(5), {"balls"}),
}


@pytest.mark.parametrize("space", PAGES)
def test_a_page_holds_the_motion_in_one_file(space, tmp_path):
    values, manifold, expected = PAGES[space]
    plotting.to_html(record(values), tmp_path / "page.html", problem=manifold, title="<b>motion</b>")
    text, data = data_of(tmp_path / "page.html")
    assert set(data) == {"times", "clock", "names", "histories", "borders"} | expected
    motion = data.get("motions", [{}])[0]
    assert set(motion) == ({"rotations", "positions"} if "mesh" in expected else {"points"} if motion else set())
    assert data["times"] == pytest.approx(np.linspace(0, 3, 31), rel=1e-8)
    for name, held in (("rotations", TURNS), ("points", np.pad(values.reshape(31, -1), ((0, 0), (0, 3)))[:, :3])):
        if name in motion:
            np.testing.assert_allclose(motion[name], held, atol=1e-8)
    assert data.get("sphere", False) == (space in ("SO(3)", "S^2"))
    assert (space == "SE(3)") == (motion.get("positions") is not None)
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
    np.testing.assert_allclose(data["motions"][0]["rotations"], solution(np.clip(times, 0, 2)).states, atol=1e-8)
    (attitude,), (rate,) = data["histories"]
    assert (attitude["held"], rate["held"]) == (False, True)
    np.testing.assert_allclose(np.array(rate["columns"])[:, :-1], solution.controls.T, atol=1e-8)
    np.testing.assert_allclose(rate["times"], solution.times, atol=1e-8)
    between = np.clip(attitude["times"], 0, 2)
    assert len(between) > 400
    vectors = Rotation.from_matrix(solution(between).states).as_rotvec()
    np.testing.assert_allclose(np.transpose(attitude["columns"]), vectors, atol=1e-8)
    assert rate["title"] == "</script>"
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
        (rate,) = data_of(tmp_path / "page.html")[1]["histories"][1]
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
    phased = PhasedSolution.of([first, second], {}, True, "")
    plotting.to_html(phased, tmp_path / "page.html")
    data = data_of(tmp_path / "page.html")[1]
    assert data["borders"] == pytest.approx([2.0])
    assert data["times"][-1] == pytest.approx(8.0)
    rotations = data["motions"][0]["rotations"]
    assert len(data["times"]) == len(rotations)
    steps = np.diff(data["times"])
    assert np.max(steps) < 1.1 * np.median(steps), "of the same speed everywhere"
    for k in (20, len(steps) // 2, len(steps)):
        t = data["times"][k]
        np.testing.assert_allclose(rotations[k], phased.phases[int(t > 2)](min(t, 8.0)).states, atol=1e-7)
    assert len(data["histories"]) == 2
    shorter_than_a_frame = replace(first, times=1e-4 * first.times, stage_times=1e-4 * first.stage_times)
    plotting.to_html(PhasedSolution.of([first, shorter_than_a_frame, second], {}, True, ""), tmp_path / "page.html")
    data = data_of(tmp_path / "page.html")[1]
    assert len(data["times"]) == len(data["motions"][0]["rotations"])


def slews(**more):
    """Two slews that differ in the horizon; the time 1 is a node of both."""
    problem = OptimalControlProblem(SO(3), lambda q, u: q @ hat(u), lambda q, u: u @ u / 2, 3, **more)
    return {
        name: solve(problem, np.eye(3), TURNS[8 * n], 2.0 * n, method=Gauss(2, Cayley(SO(3))), steps=4)
        for name, n in (("short", 1), ("<long>", 2))
    }


def test_records_to_compare_share_one_clock_and_keep_their_names(tmp_path):
    every = slews()
    plotting.to_html(every, tmp_path / "page.html")
    text, data = data_of(tmp_path / "page.html")
    assert data["names"] == ["short", "<long>"]
    assert "<title>short, &lt;long&gt;</title>" in text
    times = np.array(data["times"])
    assert (times[0], times[-1]) == pytest.approx((0.0, 4.0))
    for motion, solution in zip(data["motions"], every.values(), strict=True):
        expected = solution(np.clip(times, 0, solution.horizon)).states
        np.testing.assert_allclose(motion["rotations"], expected, atol=1e-8)
    for panel in data["histories"]:
        assert [part["record"] for part in panel] == [0, 1]
        assert [part["times"][-1] for part in panel] == pytest.approx([2.0, 4.0])
        assert panel[0]["title"] == panel[1]["title"]
    report = text.split('<pre id="report">')[1].split("</pre>")[0]
    assert report.index("short") < report.index("&lt;long&gt;")
    assert report.count("strict local minimum") == 2


def test_trajectories_to_compare_keep_their_nodes_where_these_are_the_same(tmp_path):
    pair = {"one": record(TURNS), "reversed": record(TURNS[::-1])}
    plotting.to_html(pair, tmp_path / "page.html", problem=SO(3))
    data = data_of(tmp_path / "page.html")[1]
    assert data["times"] == pytest.approx(np.linspace(0, 3, 31))
    for motion, each in zip(data["motions"], pair.values(), strict=True):
        np.testing.assert_allclose(motion["rotations"], each.q, atol=1e-8)
    plotting.to_html({"all": record(TURNS), "few": record(TURNS[::10], 4)}, tmp_path / "page.html", problem=SO(3))
    data = data_of(tmp_path / "page.html")[1]
    few = TURNS[::10][np.round(np.array(data["times"])).astype(int)]
    apart = np.abs(np.array(data["times"]) % 1 - 0.5) > 1e-6
    np.testing.assert_allclose(np.array(data["motions"][1]["rotations"])[apart], few[apart], atol=1e-8)


def test_records_that_do_not_fit_on_one_page_are_refused(tmp_path):
    with pytest.raises(InvalidInputError, match="at most 4 records, got 5"):
        plotting.to_html([record(TURNS)] * 5, tmp_path / "page.html", problem=SO(3))
    mixed = [solve(OptimalControlProblem(Q, f, lambda q, u: u @ u, n), *ends, 1.0, steps=2) for Q, f, n, ends in (
        (SO(3), lambda q, u: q @ hat(u), 3, (np.eye(3), TURNS[8])),
        (Euclidean(2), lambda q, u: u, 2, (np.zeros(2), np.ones(2))),
    )]  # fmt: skip
    with pytest.raises(InvalidInputError, match=r"in one space, got R\^2, SO\(3\)"):
        plotting.to_html(mixed, tmp_path / "page.html")
    assert not (tmp_path / "page.html").exists()


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
def test_in_a_browser_records_to_compare_move_each_on_its_own(browser, tmp_path):
    """Bodies at their own attitudes, and the values of both, with both names, at the time of the slider."""
    every = slews()
    plotting.to_html(every, tmp_path / "page.html")
    page, wrong = browser.new_page(), []
    page.on("pageerror", lambda error: wrong.append(str(error)))
    page.goto((tmp_path / "page.html").as_uri())
    page.wait_for_selector("body[data-ready=true]", timeout=60_000)
    vertices, scale = page.evaluate("[retrax.data.mesh.vertices, retrax.data.scale]")
    for frame in (60, 180):
        page.fill("#time", str(frame))
        time = float(page.evaluate("document.body.dataset.time"))
        assert time == pytest.approx(4.0 * frame / 240)
        for place, solution in enumerate(every.values()):
            drawn = page.evaluate(f"(() => {{ const m = retrax.drawn({4 * place}); return [m.x, m.y, m.z]; }})()")
            expected = scale * np.array(vertices) @ solution(min(time, solution.horizon)).states.T
            np.testing.assert_allclose(np.array(drawn).T, expected, atol=1e-7)
    page.fill("#time", "60")
    page.wait_for_selector("#histories .hoverlayer .legend", timeout=30_000)
    told = page.text_content("#histories .hoverlayer").replace("\N{MINUS SIGN}", "-")
    for name, solution in (("short", every["short"]), ("<long>", every["<long>"])):
        shown = re.findall(rf"q, rotation vector [xyz], {name}: (-?[\d.]+(?:e[-+]?\d+)?)", told)
        values = [float(found) for found in shown]
        assert values == pytest.approx(Rotation.from_matrix(solution(1.0).states).as_rotvec(), abs=1e-4)
    legend = page.text_content("#histories .infolayer")
    assert "short" in legend
    assert "<long>" in legend
    assert wrong == []
    page.close()
