"""Cases with their pictures, as both evaluations show them."""

from __future__ import annotations

import base64
import re

import cv2
import numpy as np

from visloc_companion.evaluate.reports.report_parts import case_section, worst_cases_section

RED = np.zeros((20, 30, 3), np.uint8) + np.array([200, 0, 0], np.uint8)


def test_a_case_shows_the_pictures_that_there_are() -> None:
    section = case_section("a<b", "3 m off & accepted", "score > 0.5", [(RED, "at the truth"), (None, "at the answer")])
    head = '<b>a&lt;b</b>: 3 m off &amp; accepted<br><span class="soft">score &gt; 0.5</span>'
    assert section.startswith(f'<section class="case">{head}')
    assert section.count("<img") == 1 and "at the answer" not in section
    found = re.search(r'src="data:image/jpeg;base64,([^"]+)" alt="at the truth"><figcaption>at the truth<', section)
    assert found is not None
    picture = cv2.imdecode(np.frombuffer(base64.b64decode(found[1]), np.uint8), cv2.IMREAD_COLOR)
    assert picture is not None and picture.shape == (20, 30, 3)
    assert np.abs(picture[10, 15].astype(int) - [0, 0, 200]).max() < 8, "OpenCV reads blue first"


def test_the_worst_cases_have_a_heading_where_there_are_any() -> None:
    assert worst_cases_section([]) == ""
    assert worst_cases_section(["<p>a</p>", "<p>b</p>"]) == '<h2>The worst cases</h2><div class="cases"><p>a</p><p>b</p></div>'
