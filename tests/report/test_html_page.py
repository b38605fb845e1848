"""The page of a folder: self-contained, with everything in it, operated in a real browser."""

import json
import re
import shutil
import subprocess
from html import unescape
from pathlib import Path

import numpy as np
import pytest

from rmesh_nlp.cli import app as cli
from rmesh_nlp.io.records import to_json
from rmesh_nlp.io.results import Result, Results, read_results
from rmesh_nlp.io.vtu import read_vtu
from rmesh_nlp.report.html_page import page
from rmesh_nlp.study.comparison import plan_comparison, run
from support.contact_geometry import block_between_two_foundations
from support.formulations import fixed
from support.reporting import designed, failed_61, joint_61, joint_62, saved

BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome")


pytestmark = pytest.mark.slow  # three comparisons are solved


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("compared")
    plan = plan_comparison(["6.1"], ["fixed", "joint", "nested"], n=3, quadrature=6)
    plan += plan_comparison(["6.1"], ["joint"], n=2, order=2)
    list(run(plan, Results(path)))
    assert cli.run(["report", str(path)]) == 0
    return path


SECTIONS = ("set-up", "summary", "convergence", "meshes", "solves", "notes", "environment")


def test_page_loads_nothing_and_has_all_parts_and_the_meshes_of_the_solutions(folder: Path) -> None:
    text = (folder / "report.html").read_text()
    assert re.findall(r"""\s(?:src|href)=(?!["']?#)[^\s>]*""", text) == []
    assert "://" not in re.sub(r'xmlns(:xlink)?="[^"]*"', "", text)
    assert not re.search(r"url\((?!#)", text)
    for section in SECTIONS:
        assert f'<section id="{section}">' in text
    assert text.count('<svg class="chart"') == 2
    match = re.search(r'id="meshes-json">(.*?)</script>', text, re.S)
    shown = json.loads(match[1])
    names = ["6.1, n = 3, joint", "6.1, n = 3, nested", "6.1, n = 2, order 2, joint"]
    assert [one["name"] for one in shown] == names  # what moved
    moved = [result for result in read_results(folder) if result.record["formulation"] != "fixed"]
    for one, result, corners in zip(shown, moved, (3, 3, 6), strict=True):
        fields = read_vtu(result.vtu)
        assert one["t"] == fields.triangles.T.tolist()
        assert len(one["t"][0]) == corners
        drawn = np.array([one[name] for name in ("x", "y", "x0", "y0")])
        final, given = fields.final, fields.given
        np.testing.assert_allclose(drawn, np.vstack([final.nodes, given.nodes]), rtol=1e-4, atol=1e-9)
        motion = np.linalg.norm(final.nodes - given.nodes, axis=0)
        values = {"u": final.displacement[0], "contact stress": final.pressure, "motion": motion}
        assert set(one["fields"]) == set(values)
        for name, expected in values.items():
            np.testing.assert_allclose(one["fields"][name], expected, rtol=1e-4, atol=1e-9)
    assert ">6.1, order 2<" in text
    assert ">unknowns<" in text


def test_page_of_ones_own_problem_opens_with_contact_forces_and_pressures(tmp_path: Path) -> None:
    result = saved(fixed.solve(block_between_two_foundations()), tmp_path)
    sections = page(tmp_path, [result], "", "t").split("<section ")
    assert sections[1].startswith('id="contact"')
    for name, contact in result.record["contact"].items():
        assert f">{name}</td>" in sections[1]
        assert f">{contact['normal_force']:.4g}</td>" in sections[1]
    assert sections[1].count("<svg") == 1


def test_profiles_are_drawn_of_ten_problems(tmp_path: Path) -> None:
    rows = [joint_62(n=f"{n}x{n}", formulation=name) for n in range(10) for name in ("joint", "mpcc")]
    for count, there in ((20, True), (18, False)):
        results = [Results(tmp_path).result(row) for row in rows[:count]]
        assert ('id="profiles"' in page(tmp_path, results, "", "t")) is there


def test_hostile_text_stays_text(tmp_path: Path) -> None:
    evil = "</script><script>alert(1)</script>"
    row = failed_61(message=evil, example=evil, key="x")
    (tmp_path / "records.jsonl").write_text(to_json(row) + "\n")
    text = page(tmp_path, read_results(tmp_path), evil, evil)
    assert "<script>alert" not in text
    assert text.count("&lt;script&gt;alert") >= 4  # of the title, the question, the problem, the message


def test_long_names_and_messages_are_not_cut(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("rmesh_nlp.report.html_page.svg", lambda *_, **__: "")  # the texts alone count
    name, title = "newton from forty starts " * 5, "a long title " * 9
    message = failed_61(message="a reason " * 40, key="x")
    rows = [joint_61(variant=name, family=title, key="y", seed=seed) for seed in range(20)]
    whole = page(Path("nowhere"), [Results(Path("nowhere")).result(row) for row in [message, *rows]], "", "")
    assert all(text.strip() in whole for text in ("a reason " * 40, title))
    assert "21, given mesh to seed 19" in whole
    assert "…" not in whole


WATCH = "<script>window.wrong = []; addEventListener('error', (e) => window.wrong.push(e.message));</script>"
OPERATE = """<script>
const found = { wrong: window.wrong };
const table = document.querySelector("#solves table"), heads = [...table.querySelectorAll("th")];
const column = heads.findIndex((head) => head.textContent === "J relocated");
heads[column].click();
found.sorted = [...table.tBodies[0].rows].map((row) => parseFloat(row.cells[column].textContent));
const canvas = document.querySelector("canvas"), slider = document.querySelector("#slider");
const chosen = document.querySelector("#solve");
const choose = (one) => { chosen.value = one; chosen.dispatchEvent(new Event("change")); };
choose(2); found.quadratic = document.querySelector("#viewer").dataset.drawn; choose(0);
const after = canvas.toDataURL();
slider.value = 0; slider.dispatchEvent(new Event("input"));
found.moved = canvas.toDataURL() !== after;
found.shown = document.querySelector("#shown").textContent;
const box = canvas.getBoundingClientRect();
for (let part = 0; part < 1 && !(found.hover || "").startsWith("node"); part += 0.02) {
  const where = { clientX: box.left + part * box.width, clientY: box.top + 0.5 * box.height };
  canvas.dispatchEvent(new PointerEvent("pointermove", where));
  found.hover = document.querySelector(".hover").textContent;
}
found.scale = document.querySelector(".scale").textContent;
dispatchEvent(new Event("beforeprint")); found.printed = document.querySelector("#viewer").dataset.drawn;
dispatchEvent(new Event("afterprint")); found.again = document.querySelector("#viewer").dataset.drawn;
found.empty = [...document.querySelectorAll("svg.chart")].filter(
  (chart) => ![...chart.querySelectorAll("g path")].some((path) => path.getTotalLength() > 40)).length;
found.charts = document.querySelectorAll("svg.chart").length;
found.cut = [...document.querySelectorAll("svg.chart text")].filter((text) => {
  const box = text.getBoundingClientRect(), chart = text.closest("svg").getBoundingClientRect();
  return box.left < chart.left - 1 || box.right > chart.right + 1;
}).map((text) => text.textContent);
found.overflow = document.documentElement.scrollWidth - document.documentElement.clientWidth;
const out = document.createElement("pre"); out.id = "found"; out.textContent = JSON.stringify(found);
document.body.append(out);
</script>"""


@pytest.mark.parametrize("window", ["1200,900", "390,844"])
def test_page_works_in_a_browser(folder: Path, tmp_path: Path, window: str) -> None:
    browser = next(filter(None, map(shutil.which, BROWSERS)), None)
    if browser is None:
        pytest.skip(f"no browser: none of {', '.join(BROWSERS)} is installed")
    text = (folder / "report.html").read_text()
    operated = tmp_path / "operated.html"
    operated.write_text(text.replace("<head>", f"<head>{WATCH}").replace("</body>", f"{OPERATE}</body>"))
    command = [browser, "--headless", "--no-sandbox", "--disable-gpu", f"--window-size={window}"]
    command += [f"--user-data-dir={tmp_path / 'profile'}", "--dump-dom", operated.as_uri()]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=True)
    match = re.search(r'<pre id="found">(.*?)</pre>', done.stdout, re.S)
    assert match is not None, done.stderr[-2000:]
    found = json.loads(unescape(match[1]))
    assert found["wrong"] == []
    assert found["sorted"] == sorted(found["sorted"])
    assert len(found["sorted"]) == 4
    assert found["quadratic"] == "2 1 u"
    assert found["moved"]
    assert found["shown"] == "0 %"
    assert found["hover"].startswith("node ")
    values = re.fullmatch(r"u (\S+?)(-?\d+\.\d+)", found["scale"])
    assert values is not None
    assert found["printed"] == "0 0,1 u"  # both meshes side by side on paper
    assert found["again"] == "0 0 u"
    assert found["charts"] >= 8
    assert found["empty"] == 0
    assert found["cut"] == []
    assert found["overflow"] <= 0


def test_solves_have_the_gain_in_what_was_minimised_and_energies_only_where_they_compare(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("rmesh_nlp.report.html_page.svg", lambda *_, **__: "")  # the table alone counts
    rows = [joint_62(), designed()]
    folder = tmp_path / "none"
    results = [Result(row, folder / "a.vtu", folder / "a.csv") for row in rows]
    text = page(tmp_path, results, "", "")
    solves = text[text.index('id="solves"') : text.index('id="notes"')]
    cells = [re.findall(r"<td[^>]*>(.*?)</td>", row) for row in re.findall(r"<tr>(.*?)</tr>", solves, re.S)]
    of_energy = next(row for row in cells if "1.157" in row)
    of_design = [cell for row in cells if "99.96" in row for cell in row]  # of the table with all columns too
    assert "-4.910330" in of_energy
    assert "-4.910330" not in of_design
    assert {"2.500000e+00", "1.000000e-03", "1.25", "-0.5"} <= set(of_design)
