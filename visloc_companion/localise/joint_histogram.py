"""Normalised mutual information of grey values, at one pose and exhaustively over position x heading x scale.

    NMI = (H(frame) + H(map)) / H(frame, map)  -  1        (Studholme, Hill & Hawkes 1999; here 0 for no relation, 1 at most)

The joint histogram at all shifts at once is exact: the count of (a, b) is the correlation of the mask "frame is in bin a" with
the mask "map is in bin b", one FFT product each. With bins a and b that is a * b transforms a hypothesis, hence few bins there.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from visloc_companion.localise.candidates.frame_features import ForEachPose, plane_raster
from visloc_companion.localise.candidates.hypotheses import hypotheses
from visloc_companion.localise.features.base import Float32Array
from visloc_companion.localise.features.grey import GREY
from visloc_companion.localise.frame import FrameLevel
from visloc_companion.localise.ortho_rectify import CameraPose, MapGrid
from visloc_companion.localise.plan import SearchPlan, turned
from visloc_companion.localise.search import MIN_OVERLAP, ScoreVolume
from visloc_companion.types import FloatArray

Labels = NDArray[np.uint8]
Box = tuple[int, int, int, int]


def bin_edges(values: Float32Array, valid: NDArray[np.bool_], bins: int) -> FloatArray:
    """(bins - 1,) inner edges that share the valid values evenly: haze and exposure only move them."""
    if not valid.any():
        return np.zeros(bins - 1)
    return np.asarray(np.quantile(values[valid], np.linspace(0, 1, bins + 1)[1:-1]), dtype=np.float64)


def labelled(values: Float32Array, edges: FloatArray) -> Labels:
    """The bin of every value (0..255, rounded)."""
    table = np.searchsorted(edges, np.arange(256.0)).astype(np.uint8)
    return np.asarray(cv2.LUT(cv2.convertScaleAbs(values), table), dtype=np.uint8)


def mutual_information(frame: Labels, there: Labels, both: NDArray[np.bool_], bins: int) -> float:
    """Normalised mutual information (0..1) of two labelled images over the pixels where both are valid."""
    joint = np.bincount(frame[both].astype(np.intp) * bins + there[both], minlength=bins * bins).reshape(bins, bins)
    total = joint.sum()
    if total == 0:
        return 0.0
    h_frame, h_map, h_joint = (_entropy(counts, total) for counts in (joint.sum(1), joint.sum(0), joint))
    return (h_frame + h_map) / h_joint - 1 if h_joint > 0 else 0.0


def search_histograms(grid: MapGrid, level: FrameLevel, plan: SearchPlan, bins: int) -> ScoreVolume:
    """Scores of all hypotheses at the nadir pixels of the plan's region. `grid.features` are grey values (H, W, 1)."""
    linear = grid.A_ne_pix[:, :2]
    templates = [_template(level, plan, linear, heading, scale) for heading, scale in hypotheses(plan)]
    extent = _extent(templates)
    u0, v0, u1, v1 = _nadir_box(grid, plan, extent)
    height, width = grid.weight.shape
    size = (
        cv2.getOptimalDFTSize(max(width, u1 + extent[2]) - min(0, u0 + extent[0])),
        cv2.getOptimalDFTSize(max(height, v1 + extent[3]) - min(0, v0 + extent[1])),
    )
    labels = labelled(grid.features[..., 0], bin_edges(grid.features[..., 0], grid.weight > 0, bins))
    spectra = _bin_spectra(labels, grid.weight > 0, (0, 0), size, bins)
    wanted = np.ix_(np.arange(v0, v1 + 1) % size[1], np.arange(u0, u1 + 1) % size[0])
    best = np.full((v1 - v0 + 1, u1 - u0 + 1), -1.0, np.float32)
    which = np.zeros(best.shape, np.int32)
    for k, template in enumerate(templates):
        values, seen = template.grey, template.seen
        own = _bin_spectra(labelled(values, bin_edges(values, seen, bins)), seen, template.offset_px, size, bins)
        score = _scores(own, spectra, wanted, int(seen.sum()))
        better = score > best
        best[better] = score[better]
        which[better] = k
    return ScoreVolume(best, which, (u0, v0))


def _scores(
    own: list[Float32Array], there: list[Float32Array], wanted: tuple[NDArray[np.intp], ...], n_pixels: int
) -> Float32Array:
    """Normalised mutual information at the wanted shifts; -1 where too little of the template lies on valid map."""
    n = np.arange(n_pixels + 1, dtype=np.float64)
    n_log_n = (n * np.log(np.maximum(n, 1))).astype(np.float32)
    shape = (wanted[0].shape[0], wanted[1].shape[1])
    of_map = np.zeros((len(there), *shape), np.int32)
    joint, of_frame = np.zeros(shape, np.float32), np.zeros(shape, np.float32)
    for a in own:
        row = np.zeros(shape, np.int32)
        for b, spectrum in enumerate(there):
            product = cv2.mulSpectrums(spectrum, a, 0, conjB=True)
            correlation = cv2.idft(product, flags=cv2.DFT_SCALE | cv2.DFT_REAL_OUTPUT)[wanted]
            count = np.clip(np.rint(correlation), 0, n_pixels).astype(np.int32)
            joint += n_log_n[count]
            of_map[b] += count
            row += count
        of_frame += n_log_n[np.minimum(row, n_pixels)]
    total = np.maximum(of_map.sum(0), 1)
    log_n = np.log(total)
    h_joint = log_n - joint / total
    h_both = 2 * log_n - (of_frame + n_log_n[np.minimum(of_map, n_pixels)].sum(0)) / total
    enough = (total >= MIN_OVERLAP * n_pixels) & (h_joint > 1e-6)
    return np.where(enough, h_both / np.maximum(h_joint, 1e-6) - 1, -1.0).astype(np.float32)


def _entropy(counts: NDArray[np.intp], total: int) -> float:
    p = counts[counts > 0] / total
    return -float(np.sum(p * np.log(p)))


def _bin_spectra(
    labels: Labels, valid: NDArray[np.bool_], offset_px: tuple[int, int], size: tuple[int, int], bins: int
) -> list[Float32Array]:
    rows = (np.arange(labels.shape[0]) + offset_px[1]) % size[1]
    cols = (np.arange(labels.shape[1]) + offset_px[0]) % size[0]
    spectra = []
    for b in range(bins):
        array = np.zeros((size[1], size[0]), np.float32)
        array[np.ix_(rows, cols)] = (labels == b) & valid
        spectra.append(np.asarray(cv2.dft(array), dtype=np.float32))
    return spectra


@dataclass(frozen=True, slots=True, eq=False)
class _Template:
    """Rectified frame of one hypothesis: grey values and mask (h, w), offset of its first pixel from the nadir (u, v)."""

    grey: Float32Array
    seen: NDArray[np.bool_]
    offset_px: tuple[int, int]


def _template(level: FrameLevel, plan: SearchPlan, linear: FloatArray, heading_rad: float, scale: float) -> _Template:
    A_ne_pix, size = plane_raster(plan, linear, heading_rad, scale)
    p = np.array([0.0, 0.0, -plan.ground_up_m - plan.agl_m * scale])
    pose = CameraPose(p, turned(plan.pose.R_ned_cam, heading_rad))
    values, mask = ForEachPose(level, GREY).on_plane(pose, A_ne_pix, size, plan.ground_up_m)
    first = np.rint(np.linalg.solve(linear, A_ne_pix[:, 2])).astype(int)
    return _Template(values[..., 0], mask > 0, (int(first[0]), int(first[1])))


def _extent(templates: list[_Template]) -> Box:
    """First and last-but-one pixels (u, v) of all templates about the nadir."""
    first = np.min([t.offset_px for t in templates], axis=0)
    last = np.max([(t.offset_px[0] + t.seen.shape[1], t.offset_px[1] + t.seen.shape[0]) for t in templates], axis=0)
    return int(first[0]), int(first[1]), int(last[0]), int(last[1])


def _nadir_box(grid: MapGrid, plan: SearchPlan, extent: Box) -> Box:
    """Nadir pixels within three sigmas at which the middle of the template lies on the window."""
    inverse = np.linalg.inv(grid.A_ne_pix[:, :2])
    centre = inverse @ (plan.pose.p_ned_m[:2] - grid.A_ne_pix[:, 2])
    reach = np.abs(inverse) @ plan.region_half_m
    first, last = [], []
    for k, length in enumerate(grid.weight.shape[::-1]):
        middle = (extent[k] + extent[k + 2]) / 2
        first.append(max(math.floor(centre[k] - reach[k]), math.floor(-middle)))
        last.append(max(first[k], min(math.ceil(centre[k] + reach[k]), math.ceil(length - middle))))
    return first[0], first[1], last[0], last[1]
