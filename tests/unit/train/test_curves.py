from __future__ import annotations

from xml.etree import ElementTree

import numpy as np

from visloc_companion.train.curves import curves_svg, smoothed


def test_the_drawing_is_one_well_formed_file_with_every_series() -> None:
    losses = [(step, 7.0 - step / 1000) for step in range(50, 4000, 50)]
    errors = {"farm & wood": [(400, 0.6), (800, 0.5)], "land": [(400, 0.4), (800, 0.25)]}
    drawing = curves_svg(losses, errors, {"farm & wood": 0.62, "land": 0.45}, 9000)
    root = ElementTree.fromstring(drawing)
    texts = [element.text for element in root.iter("{http://www.w3.org/2000/svg}text")]
    assert root.get("viewBox")
    assert "farm & wood 50 %" in texts
    assert "land 25 %" in texts
    assert len(list(root.iter("{http://www.w3.org/2000/svg}circle"))) == 4
    assert len(list(root.iter("{http://www.w3.org/2000/svg}path"))) == 4


def test_a_run_that_has_hardly_begun_is_drawn_too() -> None:
    ElementTree.fromstring(curves_svg([], {}, {}, 1))
    ElementTree.fromstring(curves_svg([(1, 0.0)], {"a": []}, {}, 1))


def test_smoothing_starts_at_the_first_value_and_follows() -> None:
    values = smoothed(np.concatenate([np.full(50, 4.0), np.full(200, 1.0)]))
    np.testing.assert_allclose(values[:50], 4.0)
    assert abs(values[-1] - 1.0) < 1e-3
