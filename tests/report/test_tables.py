"""Tables against literal text."""

from __future__ import annotations

import csv
import io
import re
from pathlib import Path

import pytest
from support.reporting import fixed_61, joint_61
from support.table_rows import ROWS, record

from rmesh_nlp.io.results import REQUIRED
from rmesh_nlp.report.blocks import Block, blocks, label
from rmesh_nlp.report.markup import (
    COLUMN,
    DIGIT,
    GAP,
    latex_cell,
    latex_table,
    latex_text,
    markdown_table,
    split_columns,
)
from rmesh_nlp.report.notes import notes
from rmesh_nlp.report.refinement import TITLE, refinement_notes, refinement_rows
from rmesh_nlp.report.tables import csv as as_csv
from rmesh_nlp.report.tables import latex, markdown, write_tables

MARKDOWN = """\
# Comparison of strategies

## Example 6.2: n = 12x6, delta = 0.15667 x 0.07333, midpoint rule

| strategy          | J initial |   J final | audited initial | audited final | audited gain | gain [%] |    u min |    u max | least area |
|:------------------|----------:|----------:|----------------:|--------------:|-------------:|---------:|---------:|---------:|-----------:|
| paper, given grid |   -4.8541 |         - |               - |             - |            - |        - |        - |        - |          - |
| paper, relocated  |   -4.8541 |   -4.9188 |               - |             - |            - |        - |        - |        - |          - |
| joint             | -4.854190 | -4.910330 |       -4.854190 |     -4.910330 |     0.056140 |     1.16 | -0.05358 | 0.009488 |      0.132 |
| mpcc              |         - |         - |               - |             - |            - |        - |        - |        - |          - |

| strategy | start | iterations | contact solves, cold + warm | factorisations, contact; KKT | build [s] | solve [s] | audit [s] | build + solve [solves] | tolerance |    status |
|:---------|------:|-----------:|----------------------------:|-----------------------------:|----------:|----------:|----------:|-----------------------:|----------:|----------:|
| joint    | given |         44 |                       1 + 2 |                7; 44 or more |      0.02 |      0.06 |     0.003 |                     20 |         - | converged |
| mpcc     |     - |          - |                           - |                            - |         - |         - |         - |                      - |         - |    failed |

| strategy | equilibrium, own | equilibrium, referee | complementarity, own | complementarity, referee | stationarity | biactive | label |
|:---------|-----------------:|---------------------:|---------------------:|-------------------------:|-------------:|---------:|------:|
| joint    |          3.1e-09 |              4.7e-13 |              2.0e-10 |                        0 |      2.9e-06 |        0 |   KKT |
| mpcc     |                - |                    - |                    - |                        - |            - |        - |     - |

## Notes
"""  # noqa: E501

LATEX_ENERGIES = r"""\begin{tabular}{@{}lrrr@{}}
\toprule
strategy & \shortstack[r]{$J$\\ {initial}} & \shortstack[r]{$J$\\ {final}} & \shortstack[r]{audited\\ {initial}} \\
\midrule
\multicolumn{4}{@{}l}{\emph{Example 6.2: $n$ = 12 $\times$ 6, $\delta$ = 0.15667 $\times$ 0.07333, midpoint rule}} \\
paper, given grid & $-4.8541$ & -- & -- \\
paper, relocated & $-4.8541$ & $-4.9188$ & -- \\
joint & $-4.854190$ & $-4.910330$ & $-4.854190$ \\
mpcc & -- & -- & -- \\
\bottomrule
\end{tabular}

\medskip
\begin{tabular}{@{}lrrrr@{}}
\toprule
strategy & \shortstack[r]{audited\\ {final}} & \shortstack[r]{audited\\ {gain}} & \shortstack[r]{gain\\ {[\%]}} & $u_{\min}$ \\
\midrule
\multicolumn{5}{@{}l}{\emph{Example 6.2: $n$ = 12 $\times$ 6, $\delta$ = 0.15667 $\times$ 0.07333, midpoint rule}} \\
paper, given grid & -- & -- & -- & -- \\
paper, relocated & -- & -- & -- & -- \\
joint & $-4.910330$ & $0.056140$ & $1.16$ & $-0.05358$ \\
mpcc & -- & -- & -- & -- \\
\bottomrule
\end{tabular}

\medskip
\begin{tabular}{@{}lrr@{}}
\toprule
strategy & $u_{\max}$ & \shortstack[r]{least\\ {area}} \\
\midrule
\multicolumn{3}{@{}l}{\emph{Example 6.2: $n$ = 12 $\times$ 6, $\delta$ = 0.15667 $\times$ 0.07333, midpoint rule}} \\
paper, given grid & -- & -- \\
paper, relocated & -- & -- \\
joint & $0.009488$ & $0.132$ \\
mpcc & -- & -- \\
\bottomrule
\end{tabular}
"""  # noqa: E501


def test_markdown_literally() -> None:
    assert markdown(ROWS).startswith(MARKDOWN)


def test_latex_literally() -> None:
    text = latex(ROWS)
    assert LATEX_ENERGIES in text
    assert r"joint & $3.1\cdot 10^{-9}$ & $4.7\cdot 10^{-13}$" in text
    assert r"RuntimeError: 100\% \& more\_" in text


def test_tables_fit_a_column_with_their_notes_below() -> None:
    head = ["strategy", *(f"column {k}" for k in range(12))]
    rows = [["joint", *["-1.234567"] * 12], ["nested", *["0"] * 12]]
    parts = split_columns(head, [("all", rows)])
    assert all(part[0] == 0 for part in parts)
    assert [i for part in parts for i in part[1:]] == list(range(1, 13))
    for part in parts:
        assert sum(DIGIT * max(len(head[i]), len(rows[0][i])) + GAP for i in part) <= COLUMN
    text = latex_table(head, [("all", rows)], "A caption.", ["a -1 note", "another"])
    assert text.count(r"\begin{tabular}") == len(parts)
    assert text.count(r"\begin{threeparttable}") == text.count(r"\begin{tablenotes}") == 1
    assert r"\item a $-$1 note" in text


def test_relocation_stands_beside_refinement() -> None:
    given = record(formulation="fixed", nodes=100, energy_initial_audited=-1.0, energy_audited=-1.0)
    moved = record(nodes=100, energy_initial_audited=-1.0, energy_audited=-1.2, wall_time_s=10.0)
    finer = record(
        formulation="fixed",
        n="f",
        nodes=400,
        energy_initial_audited=-1.4,
        energy_audited=-1.4,
        wall_time_s=1.0,
    )
    ((name, rows),) = refinement_rows([finer, given, moved])
    assert name == given["example"]
    assert [row[:3] for row in rows] == [
        ["as given", "no motion", "100"],
        ["as given", "joint", "100"],
        ["refined", "no motion", "400"],
    ]
    assert [row[4] for row in rows] == ["0", "0.2", "0.4"]
    (note,) = refinement_notes([finer, given, moved])
    assert "one uniform refinement (400 nodes) gains 2 times as much as joint on 100 nodes, in 0.1" in note
    assert TITLE in markdown([given, moved, finer])
    assert TITLE not in markdown([given, moved])


def test_latex_is_well_formed() -> None:
    text = latex([*ROWS, record(example="6.1", objective="error-l2", objective_value=1e-3)])
    depth = 0
    for brace in re.findall(r"(?<!\\)[{}]", text):
        depth += 1 if brace == "{" else -1
        assert depth >= 0
    assert depth == 0
    assert re.findall(r"\\begin\{(\w+)\}", text).count("table") == 4
    assert sorted(re.findall(r"\\begin\{(\w+)\}", text)) == sorted(re.findall(r"\\end\{(\w+)\}", text))
    for columns, body in re.findall(
        r"\\begin\{tabular\}\{@\{\}(\w+)@\{\}\}(.*?)\\end\{tabular\}", text, re.S
    ):
        rows = [line for line in body.splitlines() if line.endswith(r" \\") and "multicolumn" not in line]
        assert {len(re.findall(r"(?<!\\)&", row)) + 1 for row in rows} == {len(columns)}
    outside = re.sub(r"\$[^$]*\$", "", text.split("\n", 1)[1])  # without the comment on top
    assert not re.search(r"(?<!\\)[_^#%]", outside)


def test_strategies_are_ranked_by_audited_energy() -> None:
    low = record(energy=-4.91, energy_audited=-4.92)
    high = record(formulation="nested", energy=-4.93, energy_audited=-4.90)
    (said,) = [note for note in notes([high, low]) if "by audited energy" in note]
    assert said.endswith("by audited energy joint -4.920000; nested -4.900000.")
    assert Block((high, low)).best is low


def test_ends_of_one_minimum_share_a_place_and_the_first_row_is_named_as_the_lowest() -> None:
    # two solvers stop at one minimum, apart by rounding: neither is to be called the better one
    joint = record(energy=-4.92, energy_audited=-4.92)
    mpcc = record(formulation="mpcc", energy=-4.92 - 1e-11, energy_audited=-4.92 + 1e-11)
    nested = record(formulation="nested", energy=-4.92 + 1e-6, energy_audited=-4.92 + 1e-6)
    said = notes([joint, mpcc, nested])
    (order,) = [note for note in said if "by audited energy" in note]
    assert order.endswith("by audited energy joint = mpcc -4.920000; nested -4.919999.")
    assert any("-4.920000 (joint)" in note for note in said)


def test_an_energy_below_the_infimum_is_flagged() -> None:
    row = record(example="6.1", energy=-4.51, energy_audited=-1.1, energy_above_exact=0.845)
    (said,) = [note for note in notes([row]) if "BELOW" in note]
    assert "the energy -4.510000 lies BELOW the infimum -1.945000" in said
    assert not [note for note in notes([record(energy_above_exact=0.1)]) if "BELOW" in note]


def test_a_borrowed_start_is_named() -> None:
    assert label(record(formulation="mpcc", start="joint")) == "joint, certified as an MPCC solution"
    assert label(record(formulation="mpcc", start="given")) == "mpcc"


def test_the_terms_of_theorem_41_have_a_table() -> None:
    text = markdown([record(I1=0.5, I2=1e-3, I3=0.0, energy_above_exact=0.501)])
    (row,) = [line for line in text.splitlines() if "1.00e-03" in line]
    assert [cell.strip() for cell in row.split("|")[2:-1]] == [
        "0.500000", "1.00e-03", "0", "0.501000", "0.501000"
    ]  # fmt: skip
    assert "I1" not in markdown(ROWS)


def test_csv_has_every_scalar_field_and_the_paper_s_values() -> None:
    first, second = csv.DictReader(io.StringIO(as_csv(ROWS)))
    assert first["energy"] == "-4.910329789"
    assert first["paper_energy_final"] == "-4.9188"
    assert first["delta"] == "0.15667x0.07333"
    assert float(first["time_contact_solves"]) == pytest.approx(20.0)
    assert (second["status"], second["energy"]) == ("failed", "")
    assert set(REQUIRED) - {"versions"} <= set(first)


def test_outer_objectives_have_a_table_of_their_own() -> None:
    row = record(
        formulation="mpcc",
        objective="error-l2",
        relaxation="lin-fukushima",
        objective_initial=2.929e-3,
        objective_value=9.08e-4,
        biactive_nodes=[3, 4],
    )
    text = markdown([row])
    assert "| mpcc, lin-fukushima, error-l2 |  error-l2 | 2.929000e-03 | 9.080000e-04 |        2 |" in text
    assert "objective" not in markdown(ROWS)


def test_seeds_tell_rows_apart() -> None:
    assert "| joint, seed 7     |" in markdown([record(seed=7)])


def test_markup_escapes() -> None:
    assert latex_text(r"a_b & 5% \x") == r"a\_b \& 5\% \textbackslash{}x"
    assert latex_cell("1.5e-06") == r"$1.5\cdot 10^{-6}$"
    assert latex_cell("12x6") == "12x6"
    assert markdown_table(["a", "b"], [["x|y", "1"]]) == "| a    |   b |\n|:-----|----:|\n| x\\|y |   1 |\n"


@pytest.mark.parametrize("name", ["=cmd|'/c calc'!A1", "+1", "-2+3", "@SUM(A1)", "\t=1"])
def test_names_are_no_formulas_in_a_csv(name: str) -> None:
    hostile = record(example=name, message=name, **{name: 1.0})
    (row,) = csv.DictReader(io.StringIO(as_csv([hostile])))
    assert (row["example"], row["message"], row[f"'{name}"]) == (f"'{name}", f"'{name}", "1.0")
    assert float(row["energy"]) < 0  # a number stays one


def test_names_are_no_html_in_markdown() -> None:
    name = "<img src=x onerror=alert(1)>"
    for rows in (
        [record(example=name, formulation=name)],
        [record(example=name, strategy=name, family=name)],
    ):
        text = markdown(rows)
        assert text.count("&lt;img src=x") >= 2
        assert "<" not in text


def test_files(tmp_path: Path) -> None:
    text = write_tables(ROWS, tmp_path)
    assert (tmp_path / "table.md").read_text() == text
    assert (tmp_path / "table.tex").read_text() == latex(ROWS)
    assert len((tmp_path / "table.csv").read_text().splitlines()) == 3


def test_the_best_of_a_block_is_the_success_of_lowest_audited_energy() -> None:
    low, lower = (
        joint_61(energy_audited=-1.2, key="a"),
        joint_61(energy_audited=-1.3, key="b", formulation="nested"),
    )
    failed = joint_61(energy_audited=-1.9, key="c", formulation="mpcc", success=False)
    (block,) = blocks([fixed_61(), low, failed, lower])
    assert block.best is lower
