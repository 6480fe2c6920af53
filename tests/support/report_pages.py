"""A report's page as a parser reads it and as a real browser shows it."""

import json
import shutil
import subprocess
from html.parser import HTMLParser

import pytest

CHROMIUM = shutil.which("chromium")
FLAGS = (
    *("--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-sync"),
    *("--disable-background-networking", "--disable-component-update", "--virtual-time-budget=20000"),
    *("--enable-logging=stderr", "--v=0", "--window-size=1280,1000"),
)
WITH_WEBGL, WITHOUT_WEBGL, AT_NIGHT = (
    "--enable-unsafe-swiftshader",
    "--disable-3d-apis",
    "--blink-settings=preferredColorScheme=0",
)
CHART_TEXTS = ("xtitle", "ytitle", "legendtext")  # plotly's classes
needs_chromium = pytest.mark.skipif(CHROMIUM is None, reason="needs Debian's package chromium")


class Page(HTMLParser):
    """What a page refers to, its elements, its data, and its text but for scripts and styles.

    Attributes
    ----------
    attributes : every attribute's name and value.
    data : content of the JSON scripts, by id.
    drawn : how each box for a drawing ended, by name of the chart or number of the cloud.
    charts : for each chart, the drawn texts by plotly's class, and how many lines and bars were drawn.
    """

    def __init__(self, text):
        super().__init__()
        self.attributes, self.tags, self.policy, self.text = [], [], "", ""
        self.scripts, self.styles, self.data = [], [], {}
        self.drawn, self.charts = {}, {}
        self._inside, self._chart = "", {}
        self.feed(text)

    @property
    def references(self):
        names = {"src", "href", "xlink:href", "srcset", "action", "data", "poster", "formaction"}
        return [value for name, value in self.attributes if name in names]

    def handle_starttag(self, tag, attributes):
        given = dict(attributes)
        self.tags.append(tag)
        self.attributes += attributes
        self.styles += [value for name, value in attributes if name == "style"]
        self._inside = given.get("id") if tag == "script" and "id" in given else tag
        if given.get("http-equiv") == "Content-Security-Policy":
            self.policy = given["content"]
        for name in ("data-chart", "data-cloud"):
            if name in given:
                self.drawn[given[name]] = given.get("data-drawn")
        if given.get("id") == "scene-box":
            self.drawn["every scene"] = given.get("data-drawn")
        if "data-chart" in given:
            self._chart = {name: [] for name in (*CHART_TEXTS, "js-line", "point")}
            self.charts[given["data-chart"]] = self._chart
        for kind in (given.get("class") or "").split():
            if kind in self._chart:
                self._inside = kind
                self._chart[kind].append("")

    def handle_endtag(self, tag):
        self._inside = ""

    def handle_data(self, data):
        if self._inside in CHART_TEXTS:
            self._chart[self._inside][-1] += data
        if self._inside.endswith("-data"):
            self.data[self._inside] = json.loads(data)
        elif self._inside == "script":
            self.scripts.append(data)
        elif self._inside == "style":
            self.styles.append(data)
        elif self._inside != "plotly":
            self.text += data


def browse(page, profile, *flags):
    """The page as the browser has it in the end, and what it wrote to the console."""
    done = subprocess.run(
        [CHROMIUM, *FLAGS, *flags, f"--user-data-dir={profile}", "--dump-dom", page.as_uri()],
        capture_output=True,
        text=True,
        check=True,
        timeout=600,
    )
    return done.stdout, [line for line in done.stderr.splitlines() if "CONSOLE" in line]
