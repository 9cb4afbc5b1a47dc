"""What a notebook shows."""

import re
from html.parser import HTMLParser

import numpy as np

import kalfit
from conftest import BENCH, PHASES, SLEEP


class Page(HTMLParser):
    """The tags of a page, which must be closed in order."""

    def __init__(self):
        super().__init__()
        self.open, self.tags, self.text = [], [], []

    def handle_starttag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))
        if tag != "br":
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.text.append(data)


def page_of(fit):
    page = Page()
    page.feed(fit._repr_html_())
    page.close()
    assert page.open == []
    return page


def test_a_fit_is_shown_as_tables_and_a_forest_plot():
    page = page_of(kalfit.fit(*BENCH))
    text = " ".join(page.text)
    assert "Gyros on two bench stations" in text and "28 tests" in text
    assert "0.6182 ± 0.15" in page.text and "deg/h/g" in page.text
    drawings = [attrs for tag, attrs in page.tags if tag == "svg"]
    assert [attrs["aria-label"] for attrs in drawings] == [
        f"forest plot of {name}" for name in ("bias (deg/h)", "scale (ppm)", "g_sensitivity (deg/h/g)")
    ]
    assert sum(tag == "circle" for tag, _ in page.tags) == 3 * 28
    assert not any(tag in ("script", "link", "img") for tag, _ in page.tags)
    assert not re.search(r"nan|inf\b|None|https?:", kalfit.fit(*BENCH)._repr_html_())


def test_phases_and_parameters_are_shown():
    text = " ".join(page_of(kalfit.fit(*PHASES)).text)
    assert "Phase align" in text and "Phase flight" in text
    assert "sigma" in page_of(kalfit.fit(*SLEEP)).text


def test_hostile_names_are_text():
    hostile = "<script>alert('1')</script>&\""
    model = {
        "title": hostile,
        "data": {"test": "id"},
        "states": {"level": {"unit": hostile}},
        "measurements": {"y": {"column": "y", "equation": "level", "noise": 1}},
    }
    import pyarrow

    rows = pyarrow.table({"id": [hostile, "<b>", "'>"], "y": [1.0, 2.0, 4.0]})
    fit = kalfit.fit(model, rows)
    page = page_of(fit)
    assert not any(tag in ("script", "b") and attrs for tag, attrs in page.tags)
    assert "script" not in {tag for tag, _ in page.tags}
    assert hostile in page.text or any(hostile in text for text in page.text)
    labels = [attrs.get("aria-label", "") for tag, attrs in page.tags if tag == "svg"]
    assert labels == [f"forest plot of level ({hostile})"]


def test_many_tests_are_thinned_out():
    rng = np.random.default_rng(1)
    ensemble = kalfit.Ensemble.from_arrays(rng.normal(size=(1000, 2, 1)), observation=[[1.0]], noise=[[0.1]])
    shown = ensemble.fit()._repr_html_()
    assert shown.count("<circle") == 40 and "every 25th test" in shown and len(shown) < 30_000
