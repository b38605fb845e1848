"""Tables against literal text and a page, and the notes below them: each is said where records show it."""

import csv
import io
import re
import shutil
import subprocess
from pathlib import Path

import pytest

from rmesh_nlp.io.records import REQUIRED, Record
from rmesh_nlp.io.results import Results
from rmesh_nlp.report.columns import cells
from rmesh_nlp.report.html_page import page
from rmesh_nlp.report.joined import STARTS, multistart_rows, refinement_notes, with_refinement_gains
from rmesh_nlp.report.notes import block_notes, main_notes
from rmesh_nlp.report.study_summary import RANGES, summary_table
from rmesh_nlp.report.table import LINES, Table, latex_cell, latex_text
from rmesh_nlp.report.tables import csv as as_csv
from rmesh_nlp.report.tables import latex, markdown, write_tables
from rmesh_nlp.solving.parts import FEW
from support.reporting import ROWS, designed, failed, joint_61, joint_62

MARKDOWN = """\
# Comparison of formulations

| solve      |   J given | J relocated | gain [%] | iterations | contact solves | time [s] |    status |
|:-----------|----------:|------------:|---------:|-----------:|---------------:|---------:|----------:|
| 6.2, joint | -4.854190 |   -4.910330 |     1.16 |         44 |              3 |    0.083 | converged |
| 6.2, mpcc  |         - |           - |        - |          - |              - |    0.083 |    failed |

Relocation by each formulation. J is the total potential energy of the contact solution on the given and on the relocated mesh, as assessed: loads by an adaptive rule, gaps along whole edges, friction and curves integrated. Gain: in per cent of |J| on the given mesh. Time: build, solve and audit.

- 6.2, mpcc: failed: RuntimeError: 100% & more_
"""  # noqa: E501

DESIGN_ROWS = [designed(), failed(designed(), formulation="nested", wall_time_s=0.5)]

DESIGNS = """\
# Comparison of formulations

| solve                              | objective at start | objective at end | gain [%] | left on refined meshes [%] | violation | iterations |    status |
|:-----------------------------------|-------------------:|-----------------:|---------:|---------------------------:|----------:|-----------:|----------:|
| seal, mpcc, level-pressure(face)   |       2.500000e+00 |     1.000000e-03 |    99.96 |                         96 |   1.0e-01 |         44 | converged |
| seal, nested, level-pressure(face) |                  - |                - |        - |                          - |         - |          - |    failed |

Objective: with mesh and design at the start and at the end of the solve."""  # noqa: E501
DESIGN_TABLES = [
    """\
| name |      bounds | start | mpcc |
|:-----|------------:|------:|-----:|
| E    |    0.5 to 2 |     1 | 1.25 |
| h_0  | -0.5 to 0.5 |     0 | -0.5 |
""",
    """\
| name               |      bounds | mpcc |
|:-------------------|------------:|-----:|
| area               |    3.9 to 4 |    4 |
| max-pressure(face) | at most 100 |  110 |
""",
]

LATEX_MAIN = r"""\centering\footnotesize\setlength{\tabcolsep}{2.5pt}
\begin{tabular*}{\linewidth}{@{\extracolsep{\fill}}lrrrrrrr@{}}
\toprule
solve & \begin{tabular}[b]{@{}r@{}}$J$\\ {given}\end{tabular} & \begin{tabular}[b]{@{}r@{}}$J$\\ {relocated}\end{tabular} & \begin{tabular}[b]{@{}r@{}}gain\\ {[\%]}\end{tabular} & iterations & \begin{tabular}[b]{@{}r@{}}contact\\ {solves}\end{tabular} & \begin{tabular}[b]{@{}r@{}}time\\ {[s]}\end{tabular} & status \\
\midrule
6.2, joint & $-4.854190$ & $-4.910330$ & $1.16$ & $44$ & $3$ & $0.083$ & converged \\
6.2, mpcc & -- & -- & -- & -- & -- & $0.083$ & failed \\
\bottomrule
\end{tabular*}
"""  # noqa: E501

MANY = [
    *ROWS,
    *(joint_62(seed=seed) for seed in range(50)),
    joint_61(
        **{"formulation": "mpcc", "start": "joint", "relaxation": "lin-fukushima"},
        **{"status": "iteration_limit", "objective": "error-l2+0.01*quality"},
        **{"objective_initial": 1e-3, "objective_value": 2e-4},
    ),
    *(
        joint_62(
            **{"example": "a-long-name_of-a-file", "n": "123456 triangles", "delta": {"relative": 0.3}},
            **{"nodes": nodes, "energy_initial_audited": -1e-7, "energy_audited": -1.23e-7},
            **{"status": "too_few_freedoms", "wall_time_s": 1234.5, "I1": 0.1, "I2": 1e-9, "I3": 0.0},
            **{"certificate_remark": "", "energy_lower_bound": -2e8, "energy_upper_bound": -1.9e8},
            **{"common_objective": -1.23456789e-7, "units": {"length": "mm", "force": "N"}},
        )
        for nodes in (100, 400)
    ),
]
"""Fifty starts, long names, large and small numbers: what makes tables too long or too wide."""


def test_markdown_literally() -> None:
    assert markdown(ROWS, short=True) == MARKDOWN
    assert markdown([], short=True).startswith("# Comparison of formulations\n\n- No solve has ended yet.")


def test_designs_have_tables_of_their_own_and_no_energies() -> None:
    text = markdown(DESIGN_ROWS, short=True)
    assert text.startswith(DESIGNS)
    assert all(table in text for table in DESIGN_TABLES)
    assert "J is the total" not in text
    assert "Problem seal: lengths in mm, forces in N per mm of depth." in text
    assert "J given" not in text
    both = markdown([*DESIGN_ROWS, *ROWS], short=True)
    assert re.search(r"\| 6.2, joint +\| -4.854190 \|", both)
    assert re.search(r"\| seal, mpcc, level-pressure\(face\) +\| +- \| +- \| +99.96 \| ", both)
    assert all(table in both for table in DESIGN_TABLES)


def test_many_design_variables_have_a_row_each() -> None:
    names = [f"v{k}" for k in range(FEW + 1)]
    values = {name: float(k) for k, name in enumerate(names)}
    known = {"design": values, "design_initial": dict.fromkeys(names, 0.0), "constraints": None}
    row = designed(**known, design_bounds={name: [-9.0, 9.0] for name in names})
    short, details = markdown([row], short=True), markdown([row])
    assert "violation" not in short.split("\n\n")[2]
    assert "v1" not in short
    assert "| name |  bounds | start | mpcc |" in details
    assert "| v6   | -9 to 9 |     0 |    6 |" in details


def test_details_of_a_study_are_the_medians_with_their_ranges() -> None:
    rows = [joint_62(family="f", variant="a", iterations=count) for count in (4, 6, 11)]
    details = markdown(rows)
    table = summary_table(rows)
    (row,) = table.rows
    assert row[table.headings.index("iterations")] == "6 [4, 11]"
    assert table.markdown() in details
    assert f"\n\n{RANGES}" in details


def test_latex_literally_and_all_tables_as_files(tmp_path):
    text = latex(ROWS)
    assert LATEX_MAIN in text
    assert r"6.2, joint & $3.1\cdot 10^{-9}$ & $4.7\cdot 10^{-13}$" in text
    assert r"\begin{tabular}[b]{@{}r@{}}$J$ given,\\ {own rule}\end{tabular}" in text
    write_tables(ROWS, tmp_path)
    assert (tmp_path / "table.md").read_text() == markdown(ROWS)
    assert (tmp_path / "table.tex").read_text() == latex(ROWS)
    assert len((tmp_path / "table.csv").read_text().splitlines()) == 3


def test_latex_is_well_formed_and_tables_have_eight_columns_and_fit_a_page() -> None:
    text = latex(MANY)
    tables = re.findall(r"\\begin\{table.*?\\end\{table", text, re.S)
    assert len(tables) > 8
    for table in tables:
        (columns,) = re.findall(r"\\fill\}\}(\w+)@", table)
        assert len(columns) <= 8
        rows = [line for line in table.splitlines() if line.endswith(r" \\")]
        assert {len(re.findall(r"(?<!\\)&", row)) + 1 for row in rows} == {len(columns)}
        assert len(rows) <= LINES + 1  # and the head
    assert sorted(re.findall(r"\\begin\{([a-z*]+)", text)) == sorted(re.findall(r"\\end\{([a-z*]+)", text))
    assert len(re.findall(r"(?<!\\)\{", text)) == len(re.findall(r"(?<!\\)\}", text))
    outside = re.sub(r"\$[^$]*\$", "", text.split("\n", 1)[1])  # without the comment on top
    assert not re.search(r"(?<!\\)[_^#%]", outside)


def test_latex_continues_a_long_table_and_wraps_a_long_label() -> None:
    rows = [[f"seed {k}", "1"] for k in range(LINES + 1)]
    text = Table(["start", "J"], rows, "Starts.").latex(["a -1 note"])
    assert text.count(r"\begin{table}") == text.count("a $-$1 note") == 2
    assert r"\addtocounter{table}{-1}\caption{Starts. (continued)}" in text
    assert text.count("seed ") == LINES + 1
    wide = Table(["solve", *"abcdefg"], [["a long label " * 4, *["-1.234567"] * 7]]).latex()
    assert r"\begin{table*}" in wide
    assert r"\parbox[t]{60pt}{\raggedright a long label" in wide


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("pdflatex") is None, reason="needs pdflatex")
@pytest.mark.parametrize("options", ["", "twocolumn"])
@pytest.mark.parametrize("rows", [ROWS, MANY, DESIGN_ROWS], ids=["few", "many", "designs"])
def test_latex_compiles_without_overfull_boxes(rows, options, tmp_path):
    page = rf"\documentclass[{options}]{{article}}\usepackage{{booktabs}}\begin{{document}}"
    (tmp_path / "page.tex").write_text(f"{page}\n{latex(rows)}\n\\end{{document}}\n")
    subprocess.run(["pdflatex", "-halt-on-error", "page.tex"], cwd=tmp_path, check=True, stdout=-1)
    log = (tmp_path / "page.log").read_text()
    assert "Overfull" not in log
    assert "too large" not in log


CONTACT = {
    name: {"normal_force_initial": 9.0, "normal_force": force, "tangential_force": 0.0,
           "peak_pressure": 3.25, "contact_length": 0.5}
    for name, force in (("lower", 1.5), ("upper side", 2.5))
}  # fmt: skip


def test_each_of_several_contact_boundaries_has_a_row(tmp_path):
    two, one = (
        joint_62(contact=CONTACT, resultant=4.0, peak_pressure=3.25),
        joint_62(n="24x12", contact={"lower": CONTACT["lower"]}),
    )
    printed, *_ = markdown([two], short=True).split("Results of each contact boundary")
    assert (
        "| solve      |   boundary | normal force | tangential force | peak pressure | contact length |\n"
    ) in printed
    assert "| 6.2, joint | upper side |          2.5 |                0 |          3.25 |" in printed
    assert "| normal force | peak pressure |" not in markdown([two])  # it has no force of all
    assert "| lower |" not in markdown([one])
    assert "| normal force | peak pressure |" in markdown([one])
    assert markdown([two, one]).count("| upper side |") == 1
    assert r"tangential\\ {force}" in latex([two])
    (row,) = csv.DictReader(io.StringIO(as_csv([two])))
    assert [row["normal force (lower)"], row["contact length (upper side)"], row["resultant"]] == [
        "1.5", "0.5", "4.0"
    ]  # fmt: skip
    assert ">upper side</td>" in page(tmp_path, [Results(tmp_path).result(two)], "", "t")


def test_all_solves_stand_in_one_table_that_fits_a_screen() -> None:
    """Columns with one value are said once; on a screen the names of the rows are repeated."""
    given = joint_62(formulation="fixed", nodes=100, energy_initial_audited=-1.0, energy_audited=-1.0)
    moved = joint_62(nodes=100, energy_initial_audited=-1.0, energy_audited=-1.2, wall_time_s=10.0)
    finer = {**given, "n": "f", "nodes": 400, "energy_initial_audited": -1.4, "energy_audited": -1.4}
    whole = Table(*_read(markdown([given, moved, finer])))
    solves = ["6.2, n = 12x6, fixed", "6.2, n = 12x6, joint", "6.2, n = f, fixed"]
    assert [row[0] for row in whole.rows] == solves
    values = dict(zip(whole.head, zip(*whole.rows, strict=True), strict=True))
    assert values["nodes"] == ("100", "100", "400")
    assert values["gain over the given mesh"] == ("0", "0.2", "0.4")
    assert all(len({*column}) > 1 for column in values.values())
    text = markdown([given, moved, finer], width=80)
    assert "The same for all: iterations 44, " in text
    lines = [line for line in text.splitlines() if line.startswith("|")]
    assert max(map(len, lines)) <= 80
    assert {line.split("|")[1].strip() for line in lines} == {*solves, "solve", "", ":" + "-" * 21}
    assert sum(line.count("|") - 2 for line in lines if "12x6, joint" in line) == len(values) - 1


def _read(text: str) -> tuple[list[str], list[list[str]]]:
    """Head and rows of the only table of a text."""
    (table,) = re.findall(r"(?:^\|.*\n)+", text, re.M)
    head, _, *rows = ([cell.strip() for cell in line.split("|")[1:-1]] for line in table.splitlines())
    return head, rows


def test_relocation_stands_beside_refinement(tmp_path: Path) -> None:
    given = joint_62(formulation="fixed", nodes=100, energy_initial_audited=-1.0, energy_audited=-1.0)
    moved = joint_62(nodes=100, energy_initial_audited=-1.0, energy_audited=-1.2, wall_time_s=10.0)
    finer = {**given, "n": "f", "nodes": 400, "energy_audited": -1.4, "wall_time_s": 1.0}

    def gains(*records: Record) -> list[float | None]:
        return [record["refinement_gain"] for record in with_refinement_gains(records)]

    worse, finest = {**moved, "energy_audited": -1.1}, {**finer, "nodes": 1600, "energy_audited": -1.5}
    (note,) = refinement_notes([finest, worse, finer, given, moved])
    assert "one uniform refinement (400 nodes) gains 2 times as much as joint on 100 nodes, in 0.1" in note
    results = [Results(tmp_path).result(row) for row in (given, moved, finer)]
    assert note in page(tmp_path, results, "", "")
    useless = {**moved, "energy_audited": -1.0 - 1e-15}
    assert gains(given, useless, finer) == [0, 0, pytest.approx(0.4)]
    assert refinement_notes([given, useless, finer]) == ["6.2: no formulation gained on the given mesh."]
    quadratic = {**given, "order": 2, "nodes": 400}  # another discretisation, no refinement
    assert gains(given, quadratic) == [None, None]
    for no_row in ({**moved, "success": False}, {**moved, "objective": "error-l2"}, {**moved, "nodes": None}):
        assert gains(given, finer, no_row)[2] is None
    assert "gain over the given mesh" not in markdown([given, moved])


SOLVES = [joint_61(seed=seed, energy_audited=end) for seed, end in ((None, -1.47), (1, -1.48), (2, -1.46))]


@pytest.mark.parametrize(
    ("rows", "row"),
    [
        ([*SOLVES, failed(joint_61(), formulation="joint", seed=3)],
         ["joint", "4", "-1.48", "-1.47", "-1.46", "1", "50"]),
        ([joint_61(start_energies=[-1.4, None, -1.5])], ["joint", "3", "-1.5", "-1.45", "-1.4", "1", "-"]),
        ([joint_61(start_energies=[-1.4, -1.5], start_values=[0.25, 0.5], objective="error-l2")],
         ["joint, error-l2", "2", "0.25", "0.375", "0.5", "0", "-"]),
    ],
)  # fmt: skip
def test_several_starts_are_joined(rows: list[Record], row: list[str]) -> None:
    assert cells(STARTS, multistart_rows(rows)) == [[f"6.1, {row[0]}", *row[1:]]]
    assert "Several starts" in markdown(rows)
    assert not multistart_rows(SOLVES[:1])


def test_errors_and_other_objectives_have_tables_of_their_own() -> None:
    text = markdown([joint_62(I1=0.5, I2=1e-3, I3=0.0, energy_above_exact=0.501)])
    assert "| 0.500000 | 1.00e-03 |   0 | 0.501000 |      0.501000 |" in text
    row = joint_62(formulation="mpcc", objective="error-l2", biactive_nodes=[3, 4])
    text = markdown([{**row, "objective_initial": 2.929e-3, "objective_value": 9.08e-4}])
    assert "|       2.929000e-03 |     9.080000e-04 |" in text
    assert "|       69 |" in text
    assert "|        2 |   KKT |" in text.partition("first-order residual")[2]
    assert "I1" not in markdown(ROWS)
    assert "objective at end" not in markdown(ROWS, short=True)
    row = joint_62(formulation="nested", objective="shear(top)", coulomb_residual=1e-3)
    text = markdown([{**row, "objective_initial": -2.0, "objective_value": -3.0}], short=True)
    assert "J relocated" not in text
    assert "| 6.2, nested, shear(top) |      -2.000000e+00 |    -3.000000e+00 |       50 |" in text
    assert "bounds" not in text
    assert "J relocated" in markdown([joint_62(formulation="fixed", coulomb_residual=1e-3)], short=True)


def test_csv_has_every_scalar_field_designs_and_constraints() -> None:
    first, second = csv.DictReader(io.StringIO(as_csv(ROWS)))
    assert next(iter(first)) == next(iter(ROWS[0])), "no column of row numbers"
    assert first["energy"] == "-4.910329789"
    assert first["delta"] == "0.15667x0.07333"
    assert float(first["time_contact_solves"]) == pytest.approx(20.0)
    assert (second["status"], second["energy"]) == ("failed", "")
    assert first["order"] == "1"  # old rows do not name it
    assert set(REQUIRED) - {"versions"} <= set(first)
    first, second = csv.DictReader(io.StringIO(as_csv(DESIGN_ROWS)))
    assert (first["design.E"], first["constraint.max-pressure(face)"]) == ("1.25", "110.0")
    assert second["design.E"] == ""


def test_markup_escapes() -> None:
    assert latex_text(r"a_b & 5% \x") == r"a\_b \& 5\% \textbackslash{}x"
    assert latex_cell("1.5e-06") == r"$1.5\cdot 10^{-6}$"
    assert latex_cell("12x6") == "12x6"
    table = Table(["a", "b"], [["x|y", "1"]]).markdown()
    assert table == "| a    |   b |\n|:-----|----:|\n| x\\|y |   1 |\n"


def test_names_are_no_formulas_in_a_csv_and_no_html_in_markdown() -> None:
    name = "=cmd|'/c calc'!A1"
    (row,) = csv.DictReader(io.StringIO(as_csv([joint_62(example=name, message=name, **{name: 1.0})])))
    assert (row["example"], row["message"], row[f"'{name}"]) == (f"'{name}", f"'{name}", "1.0")
    assert float(row["energy"]) < 0  # a number stays one
    name = "<img src=x onerror=alert(1)>"
    for changes in ({"formulation": name}, {"variant": name, "family": name}):
        text = markdown([joint_62(example=name, **changes)])
        assert text.count("&lt;img src=x") >= 2
        assert "<" not in text


EARLY = joint_62(status="iteration_limit")
METRES = {"units": {"length": "m", "force": "N"}}


@pytest.mark.parametrize(
    ("rows", "count", "said"),
    [
        ([joint_62(), EARLY], 1, "a success that is valid and not worse than the given mesh, but not"),
        ([joint_62(**METRES), joint_62(example="6.3", **METRES), joint_61(units={})], 1,
         "Example 6.2, Example 6.3: lengths in m, forces in N per m of depth, J in N."),
        ([joint_62(example="6.1", energy=-4.51, energy_audited=-1.1, energy_above_exact=0.845)], 1,
         "joint: the energy -4.510000 lies BELOW the infimum -1.945000: its quadrature"),
        ([joint_62(guaranteed_lower=True, energy_lower_bound=-4.9)], 1,
         "the audited energy -4.910330 lies BELOW the infimum -4.900000"),
        ([joint_62(), {**EARLY, "success": False}], 0, "iteration_limit: a success"),
        ([joint_62(energy_above_exact=0.1)], 0, "BELOW"),
        ([joint_62(energy_lower_bound=-4.9)], 0, "BELOW"),
        ([joint_62(**METRES | {"units": {"length": "m"}})], 0, "u in m"),
    ],
)  # fmt: skip
def test_a_note_is_said_once_where_records_show_it(rows: list[Record], count: int, said: str) -> None:
    notes = {*main_notes(rows), *block_notes(rows)}
    assert len([note for note in notes if said in note]) == count
