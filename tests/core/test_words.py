"""Texts of strangers in Markdown, HTML and pictures stand for themselves, whatever they hold."""

from html.parser import HTMLParser
from pathlib import Path

import markdown
import pandas as pd
import pytest
from support.tables import rows

from lmd.core.words import as_code, escaped, markdown_table
from lmd.detection.calibration import limits_markdown
from lmd.estimation import pairs
from lmd.plot.charts import save_heat_map
from lmd.plot.common import literal, new_figure
from pipelines.operations.sweeps.folder import Job, JobFolder, Sweep
from pipelines.operations.sweeps.summary import Outcome, by_group

PAYLOADS = rows(__file__, "texts of strangers")
EXTENSIONS = ["tables", "attr_list", "admonition", "pymdownx.highlight", "pymdownx.superfences"]  # of the site
HARMLESS = {"table", "thead", "tbody", "tr", "th", "td", "p", "code", "strong", "h1", "h2", "html", "head", "meta"}
HARMLESS |= {"title", "style", "body"}


class Page(HTMLParser):
    """The elements of a page, and the text of each cell."""

    def __init__(self, text):
        super().__init__()
        self.tags, self.attributes, self.cells, self.text = set(), set(), [], ""
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self.tags.add(tag)
        self.attributes |= {name for name, _ in attrs}
        if tag in ("td", "th"):
            self.cells.append("")

    def handle_data(self, data):
        self.text += data
        if self.cells:
            self.cells[-1] += data.rstrip("\n")


def shown(text):
    """What a reader sees of a payload: what cannot be printed is an escape."""
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text).strip()


def rendered(text):
    page = Page(markdown.markdown(text, extensions=EXTENSIONS))
    assert page.tags <= HARMLESS
    assert page.attributes <= {"style", "align"}
    return page


@pytest.mark.parametrize("payload", PAYLOADS)
@pytest.mark.parametrize("shield", [escaped, as_code])
def test_a_cell_shows_what_a_text_holds(shield, payload):
    page = rendered(markdown_table([shield(payload), "b"], [[shield(payload), "1"], ["2", shield(payload)]]))
    assert [cell.strip() for cell in page.cells] == [shown(payload), "b", shown(payload), "1", "2", shown(payload)]


def test_usual_names_are_left_as_they_are():
    for name in ("annealing", "pymoo_ga optimiser.population=20", "Lei's 3.5 (b), x/y: 50%", "objective.n"):
        assert escaped(name) == name
        assert as_code(name) == f"`{name}`"
    assert as_code("optimisers=[a,b]") == "`optimisers=[a,b]`"


@pytest.mark.parametrize("payload", PAYLOADS)
def test_names_in_tables_of_results(payload):
    names = ("views", "pitch", "blur", "edge", "incidence", "margin", "accuracy", "precision", "recall")
    row = dict.fromkeys(names, 0.5)
    assert rendered(limits_markdown({payload: row})).cells[14].strip() == shown(payload)
    pair = {"position_ratio": 1.0, "position_better": 1, "flights": 2, "position_p": 0.5}
    pair |= {f"{pairs.PAIRED_FIGURE}_gain": 0.1, f"{pairs.PAIRED_FIGURE}_p": 0.5}
    table = pd.DataFrame([{"deployment": payload, "against": payload, "estimator": payload, **pair}])
    assert [c.strip() for c in rendered(pairs.to_markdown(table)).cells[8:11]] == [shown(payload)] * 3


@pytest.mark.parametrize("payload", PAYLOADS)
def test_what_a_sweep_varies(payload):
    job = Job("sweep", None, 0, (), {payload: payload}, status="finished")
    text = by_group(Sweep("sweep", (payload,)), [Outcome(JobFolder(Path("x")), job, {"fitness": 0.5})])
    assert rendered(text).cells[-4].strip() == shown(payload)


@pytest.mark.parametrize("payload", [*PAYLOADS, r"\$x_{$", "$\\frac{$", "$$"])
def test_a_picture_shows_a_text_as_it_is(payload, tmp_path):
    """A `$` would begin a formula, and half of one raises."""
    figure = new_figure((2.0, 2.0), payload)
    figure.savefig(tmp_path / "a.png")
    index = pd.Index([payload], name=payload)
    save_heat_map(tmp_path / "b.png", {payload: pd.DataFrame([[0.5]], index=index, columns=index)}, payload, "label")
    drawn = new_figure((2.0, 2.0)).text(0.0, 0.0, literal(payload))
    assert drawn._preprocess_math(drawn.get_text())[0] == "".join(
        c if c.isprintable() else c.encode("unicode_escape").decode() for c in payload
    )
