"""The report as Chromium renders it: everything is there, the console stays silent, no text leaves its drawing."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
from pathlib import Path
from types import ModuleType

import cv2
import numpy as np
import pytest

from visloc_companion.errors import Reason
from visloc_companion.evaluate.clouds.cloud_metrics import CloudResult, cloud_error, summarise
from visloc_companion.evaluate.clouds.cloud_report import write_cloud_report
from visloc_companion.evaluate.gate import Check
from visloc_companion.evaluate.report import write_flight_report
from visloc_companion.evaluate.reports.report_pictures import PicturePair, picture_section
from visloc_companion.evaluate.reports.report_style import CSS
from visloc_companion.localise.registration.base import Registered

pytestmark = pytest.mark.browser

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
FLAGS = (
    *("--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-background-networking"),
    *("--disable-component-update", "--disable-sync", "--disable-dev-shm-usage", "--enable-logging=stderr", "--v=0"),
)
PROBE = """
<script>
addEventListener('load', () => {
  const out = [];
  const page = document.documentElement;
  if (page.scrollWidth > page.clientWidth + 1) out.push('page is wider than the window: ' + page.scrollWidth);
  for (const svg of document.querySelectorAll('main svg[role=img]')) {
    const box = svg.getBoundingClientRect();
    const texts = [...svg.querySelectorAll('text')];
    for (const t of texts) {
      const r = t.getBoundingClientRect();
      if (r.left < box.left - 2 || r.right > box.right + 2 || r.top < box.top - 2 || r.bottom > box.bottom + 2)
        out.push('outside: ' + t.textContent);
    }
    for (let i = 0; i < texts.length; i++) for (let j = i + 1; j < texts.length; j++) {
      const a = texts[i].getBoundingClientRect(), b = texts[j].getBoundingClientRect();
      const w = Math.min(a.right, b.right) - Math.max(a.left, b.left), h = Math.min(a.bottom, b.bottom) - Math.max(a.top, b.top);
      if (w > 1 && h > 3) out.push('overlap: ' + texts[i].textContent + ' / ' + texts[j].textContent);
    }
  }
  const pre = document.createElement('pre');
  pre.id = 'probe';
  pre.textContent = 'faults ' + out.length + ': ' + out.join('; ');
  document.body.append(pre);
});
</script>
"""


def chromium(page: Path, profile: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    if CHROMIUM is None:
        pytest.skip("Chromium is not installed (apt-get install chromium)")
    command = [CHROMIUM, *FLAGS, f"--user-data-dir={profile}", *arguments, page.as_uri()]
    return subprocess.run(command, capture_output=True, text=True, timeout=90, check=True)


@pytest.fixture(scope="module")
def report(synthetic: ModuleType, tmp_path_factory: pytest.TempPathFactory) -> Path:
    page = tmp_path_factory.mktemp("report") / "report.html"
    checks = [Check("median error while GNSS is denied (m)", 0.9, "<= 2", True), Check("failsafe", "none", "none", True)]
    write_flight_report(
        synthetic.make_record(),
        page,
        title="Slow drag, then jamming",
        checks=checks,
        baseline=synthetic.make_baseline(),
        gnss_faults_s=[(60.0, 200.0)],
    )
    return page


def test_everything_is_on_the_page(report: Path, tmp_path: Path) -> None:
    shown = chromium(report, tmp_path / "profile", "--dump-dom")
    for words in ("PASS", "Slow drag, then jamming", "The same flight without it", "no fix: ambiguous"):
        assert words in shown.stdout
    assert shown.stdout.count('role="img"') == 6
    assert not re.findall(r"CONSOLE|Uncaught|Failed to load|ERR_", shown.stderr)


@pytest.mark.parametrize("width", [1280, 800, 500])
def test_no_text_overlaps_or_leaves_its_drawing(report: Path, tmp_path: Path, width: int) -> None:
    probed = tmp_path / "probed.html"
    probed.write_text(report.read_text().replace("</main>", "</main>" + PROBE))
    shown = chromium(probed, tmp_path / "profile", "--dump-dom", f"--window-size={width},2400")
    found = re.search(r'<pre id="probe">(.*?)</pre>', shown.stdout, re.DOTALL)
    assert found is not None
    assert found.group(1) == "faults 0: "


def test_tracks_are_drawn_in_their_colours(report: Path, tmp_path: Path) -> None:
    picture = tmp_path / "shot.png"
    chromium(report, tmp_path / "profile", f"--screenshot={picture}", "--window-size=1280,2600")
    pixels = cv2.imread(str(picture))
    assert pixels is not None
    for name, bgr in (("estimate", (180, 104, 0)), ("baseline", (156, 58, 139)), ("gnss", (10, 71, 208))):
        near = np.abs(pixels.astype(int) - bgr).max(axis=2) < 12
        assert near.sum() > 100, name


def test_on_a_phone_what_was_met_is_seen_without_scrolling(report: Path, tmp_path: Path) -> None:
    """In a frame, because Chromium's own window is never narrower than 500 pixels."""
    (tmp_path / "page.html").write_text(report.read_text().replace("&lt;= 2", "denied or suspect"))
    outer = tmp_path / "outer.html"
    outer.write_text(
        "<iframe src='page.html' style='width:375px;height:900px'></iframe><script>addEventListener('load', () => {"
        "const box = frames[0].document.querySelector('table').parentElement;"
        "document.title = 'wider by ' + (box.scrollWidth - box.clientWidth) + ' px';})</script>"
    )
    shown = chromium(outer, tmp_path / "profile", "--dump-dom", "--allow-file-access-from-files")
    assert "<title>wider by 0 px</title>" in shown.stdout


@pytest.mark.parametrize("width", [1280, 1000, 500])
def test_the_picture_of_the_camera_is_beside_that_of_the_map(tmp_path: Path, width: int) -> None:
    pixels = cv2.imencode(".jpg", np.zeros((48, 64, 3), np.uint8))[1].tobytes()
    page = tmp_path / "pairs.html"
    page.write_text(
        f"<style>{CSS}</style><main>{picture_section([PicturePair(float(t), pixels, pixels) for t in range(4)])}</main>"
        "<script>addEventListener('load', () => {const tops = [...document.querySelectorAll('figure')]"
        ".map(f => Math.round(f.getBoundingClientRect().top));document.title = 'apart: ' + "
        "tops.filter((top, k) => k % 2 && top != tops[k - 1]).length;})</script>"
    )
    shown = chromium(page, tmp_path / "profile", "--dump-dom", f"--window-size={width},1200")
    assert "<title>apart: 0</title>" in shown.stdout


@pytest.mark.parametrize("width", [1280, 500])
def test_the_page_of_a_cloud_evaluation(tmp_path: Path, width: int) -> None:
    """Nine answers, one far off: pictures are shown, the console stays silent, nothing leaves its drawing."""
    rng = np.random.default_rng(1)
    points = rng.uniform(-30, 30, (900, 3)) * [1, 1, 0.1]
    np.savez(tmp_path / "cloud.npz", points=points)
    sigmas = {f"sigma_{name}": 1.0 for name in ("horizontal_m", "vertical_m", "yaw_deg", "tilt_deg", "scale")}
    cases = [{"id": f"wood_A_{k:02d}", "source": "cloud.npz", "reference": "cloud.npz", **sigmas} for k in range(9)]
    (tmp_path / "cases.json").write_text(json.dumps(cases))
    truth = [{"id": case["id"], "T_reference_source": np.eye(4).tolist()} for case in cases]
    (tmp_path / "truth.json").write_text(json.dumps(truth))
    results = []
    for k, case in enumerate(cases):
        T = np.eye(4)
        T[:2, 3] = rng.normal(size=2) if k else (12.0, 0.0)
        answer = Registered(T, np.eye(3), 0.01, 0.001, 0.3 if k > 6 else 0.01, (("peak", 0.8),))
        error = cloud_error(answer, np.eye(4), points)
        reason = Reason.AMBIGUOUS if k > 6 else None
        results.append(CloudResult(case["id"], answer, reason, elapsed_ms=100.0, error=error, has_truth=True))
    page = write_cloud_report(tmp_path / "report", {"method": "any", "summary": summarise(results)}, results, tmp_path)
    page.write_text(page.read_text().replace("</main>", "</main>" + PROBE))
    shown = chromium(page, tmp_path / "profile", "--dump-dom", f"--window-size={width},2400")
    found = re.search(r'<pre id="probe">(.*?)</pre>', shown.stdout, re.DOTALL)
    assert found is not None and found.group(1) == "faults 0: "
    assert shown.stdout.count("<figure") == 45
    assert not re.findall(r"CONSOLE|Uncaught|Failed to load|ERR_", shown.stderr)
