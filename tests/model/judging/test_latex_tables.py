"""The tables of a report as LaTeX."""

import re
from pathlib import Path

from model.judging.latex_tables import escaped

CITATION = Path(__file__).parents[3] / "CITATION.cff"


def test_the_tables_in_latex_have_the_same_numbers(judged_run):
    report, folder = judged_run
    text = (folder / "tables.tex").read_text()
    assert text.count(r"\begin{table}") == text.count(r"\end{tabular}") == 1 + len(report.groups)
    for measure, who, texts in report.lines():
        assert " & ".join((escaped(measure.name), who, *texts)) in text
    for table in report.groups:
        for group in table.groups:
            assert f"{escaped(group.name)} & {group.count} & {100 * group.depth_mae_m:.2f} &" in text
    rows = [line for line in text.splitlines() if line.endswith(r"\\")]
    assert {line.count(" & ") for line in rows} == {5}


def test_the_references_are_those_of_the_citation_file(judged_run):
    _, folder = judged_run
    text = (folder / "references.bib").read_text().replace("{", "").replace("}", "")
    cited = CITATION.read_text()
    told = re.findall(r"^(?:[^\n]*[ -])?(?:title|name|names|value|version): \"?([^\"\n]+)", cited, re.M)[1:]
    assert len(told) == 12
    assert [each for each in told if each not in text] == []


def test_no_name_is_a_command_of_latex():
    told = escaped("\\input{x}\n$a_b^c~ & 5 %\x00 #<>|")
    assert told == (
        r"\textbackslash{}input\{x\} \$a\_b\textasciicircum{}c\textasciitilde{} \& 5 \% "
        r"\#\textless{}\textgreater{}\textbar{}"
    )
