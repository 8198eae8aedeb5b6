"""Tests of the drawing of figures for pages."""

import html
import re
from xml.etree import ElementTree

import numpy as np
import plotly.graph_objects as go
import pytest
from plotly.subplots import make_subplots

from mrd_base.drawing import LEGEND_ROW, _shortened, draw
from mrd_base.figures import LAYOUT, NARROW, to_html


def texts(svg: str) -> list[str]:
    """Return the texts of a drawing."""
    return [html.unescape(text) for text in re.findall(r">([^<>]*\S[^<>]*)</(?:text|tspan)>", svg)]


def bars() -> go.Figure:
    error = {"type": "data", "symmetric": False, "array": [0.1, None], "arrayminus": [0.1, None]}
    figure = go.Figure(go.Bar(x=[0.0181, 0.5], y=["first<br>bar", "$second$"], orientation="h", error_x=error))
    figure.add_annotation(x=0.6, y=1, text="<b>50.125 %</b>", showarrow=False)
    figure.update_xaxes(title_text="share", tickformat=".0%", range=[0, 1])
    return figure.update_layout(**LAYOUT, height=300)


def test_texts_are_written_as_they_are():
    written = texts(draw(bars(), 600))
    # A number in a text keeps its digits, a tag becomes what it means, and a dollar is a dollar.
    assert {"share", "first", "bar", "$second$", "50.125 %", "0 %", "100 %"} <= {text.strip() for text in written}


def test_a_drawing_is_the_same_each_time_and_has_names_of_its_own():
    assert draw(bars(), 600) == draw(bars(), 600)
    lines = go.Figure([go.Scatter(x=[0, 1], y=[0, 1], mode="lines+markers")]).update_layout(height=300)
    names = [set(re.findall(r' id="(m[0-9a-f]+|p[0-9a-f]+)"', draw(lines, width))) for width in (360, 600)]
    assert all(names)
    assert not names[0] & names[1]


def test_a_drawing_has_no_groups_that_do_nothing():
    elements = list(ElementTree.fromstring(draw(bars(), 600)).iter())
    assert {"path", "text", "g"} <= {element.tag for element in elements}  # error bars are clipped as a group
    assert all(element.attrib for element in elements if element.tag == "g")


def test_colours_follow_the_page():
    svg = draw(bars(), 600)
    assert "var(--ink)" in svg
    assert "#010203" not in svg


def test_a_long_line_is_thinned_to_what_can_be_seen():
    time = np.linspace(0, 10, 20_000)
    long = go.Figure(go.Scatter(x=time, y=np.sin(time))).update_layout(height=300)
    assert len(draw(long, 600)) < 40_000


def points(path: str) -> list[tuple[float, float]]:
    """Return the points of a path of straight lines."""
    found: list[tuple[float, float]] = []
    for command, numbers in re.findall(r"([MLl])([^MLlz]*)", path):
        pairs = [float(number) for number in re.findall(r"-?(?:\d+\.?\d*|\.\d+)", numbers)]
        for x, y in zip(pairs[::2], pairs[1::2], strict=True):
            found.append((found[-1][0] + x, found[-1][1] + y) if command == "l" else (x, y))
    return found


def test_a_shortened_path_has_the_same_points():
    random = np.random.default_rng(0).uniform(-500, 500, (2000, 2))
    random[1::2] = random[::2] + 0.3
    path = "".join(f"{'M' if k % 400 == 0 else 'L'} {x:.2f} {y:.2f} \n" for k, (x, y) in enumerate(random))
    assert np.allclose(points(_shortened(path)), random, atol=0.06)
    assert len(_shortened(path)) < 0.7 * len(path)
    assert _shortened("M 1 2 L 3.04 -4 L 3 -3.5 z") == "M1 2l2-6 0 .5z"
    assert _shortened("M 0.55 5.25 C 1.23 4 5 6 7 8") == "M 0.5 5.2 C 1.2 4 5 6 7 8"


def test_rows_columns_titles_and_maps_have_their_places():
    figure = make_subplots(rows=2, cols=1, subplot_titles=["above", "below"])
    for row in (1, 2):
        figure.add_trace(go.Heatmap(x=[0, 1, 2], y=[0, 1], z=[[1.0, np.nan]], coloraxis="coloraxis"), row, 1)
    figure.update_layout(height=400, coloraxis={"colorscale": "RdBu", "cmin": 0, "cmax": 1})
    svg = draw(figure, 360)
    assert svg.count("<image") >= 2
    assert [text for text in texts(svg) if text in ("above", "below")] == ["above", "below"]


def test_dates_are_dates():
    figure = go.Figure(go.Scatter(x=["2026-01-01", "2026-03-01"], y=[1, 2])).update_layout(height=300)
    assert any("2026" in text for text in texts(draw(figure, 600)))


def test_ticks_of_a_narrow_drawing_do_not_touch():
    figure = bars().update_xaxes(tickvals=[-0.5, -0.25, 0, 0.25, 0.5, 0.75, 1], range=[-0.5, 1])
    labels = [text for text in texts(draw(figure, 300)) if re.fullmatch(r"\D?\d+ %", text)]
    assert "0 %" in labels
    assert len(labels) <= 5
    assert len([text for text in texts(draw(figure, 900)) if re.fullmatch(r"\D?\d+ %", text)]) == 7


def test_a_label_of_two_lines_takes_the_room_of_its_longer_line():
    figure = bars().update_xaxes(tickvals=[-1, -0.5, 0, 0.5, 1], range=[-0.3, 1.05])
    figure.data[0].y = ["nonlinearity of the<br>position transducer", "delay"]
    assert {"0 %", "100 %"} <= set(texts(draw(figure, NARROW)))


def test_a_text_beside_a_narrow_diagram_covers_no_bar():
    figure = bars().update_yaxes(autorange=True)
    figure.data[0].x = [1.0, 0.5]
    figure.layout.annotations = ()
    beside = {"x": 1.03, "xref": "paper", "xanchor": "left", "showarrow": False}
    figure.add_annotation(text="> 99 %", y="first<br>bar", **beside)
    figure.add_annotation(text="probability", y=1.0, yref="paper", yanchor="bottom", **beside)
    svg = draw(figure, NARROW)
    right = max(x for path in re.findall(r'<path d="([^"]*)"[^>]*fill: #00798c', svg) for x, _ in points(path))
    for text in ("&gt; 99 %", "probability"):
        begin = float(re.search(rf'<text[^>]* x="([\d.]+)"[^>]*>{text}<', svg)[1])
        assert begin > right, text
        assert begin + 0.5 * 12 * len("probability") < NARROW


def test_a_trace_that_cannot_be_drawn_is_refused():
    with pytest.raises(ValueError, match="trace pie: expected one of scatter, bar, heatmap"):
        draw(go.Figure(go.Pie(values=[1])).update_layout(height=300), 600)


def test_a_wide_figure_is_also_drawn_for_a_telephone():
    part = to_html(bars())
    assert part.count("<svg") == 2
    assert part.count("aria-label") == 1


def test_a_legend_of_many_rows_takes_no_room_from_the_diagram():
    def height(names: list[str]) -> float:
        lines = [go.Scatter(x=[0, 1], y=[0, 1], name=name) for name in names]
        svg = draw(go.Figure(lines).update_layout(**LAYOUT, height=300), 360)
        return float(re.search(r'viewBox="0 0 [\d.]+ ([\d.]+)"', svg)[1])

    assert height(["a", "b"]) == 300
    assert height([f"a line with a long name, {number}" for number in range(16)]) >= 300 + 7 * LEGEND_ROW
