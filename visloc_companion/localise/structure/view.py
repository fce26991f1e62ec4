"""Virtual pinhole cameras: a frame as a camera of another attitude would have seen it from the same place."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from visloc_companion.geo.camera import unproject
from visloc_companion.localise.lens_maps import where_seen
from visloc_companion.localise.masked import ground_of
from visloc_companion.types import CameraModel, FloatArray, Image

DOWN: FloatArray = np.array([0.0, 0.0, -1.0])
"""Straight down in `local`."""
FARTHEST = 2.0
"""Tangent of the angle from the view's axis beyond which nothing is looked at."""
EDGE_POINTS = 12


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """A virtual camera: attitude `R_local_view` (3, 3), focal length, and the window of its image plane that is drawn.

    Image-plane coordinates are pixels from the axis; pixel (0, 0) of the window lies at `corner` (x, y).
    """

    R_local_view: FloatArray
    focal_px: float
    corner: tuple[float, float]
    size: tuple[int, int]

    def shifted(self, dx: float) -> View:
        """The same with the window moved along x."""
        return View(self.R_local_view, self.focal_px, (self.corner[0] + dx, self.corner[1]), self.size)

    def rays(self, pix: FloatArray) -> FloatArray:
        """(N, 2) pixels of the window to (N, 3) directions in the view's axes, third component 1."""
        return np.column_stack([(pix + np.array(self.corner)) / self.focal_px, np.ones(len(pix))])

    def pixels(self, points_view: FloatArray) -> FloatArray:
        """(N, 3) points or directions in the view's axes to (N, 2) pixels of the window."""
        return np.asarray(points_view[:, :2] / points_view[:, 2:3] * self.focal_px - np.array(self.corner), dtype=np.float64)

    def render(self, grey: Image, model: CameraModel, R_local_cam: FloatArray) -> tuple[Image, NDArray[np.bool_]]:
        """(H, W) what the frame shows of the window, and the mask of where it does, and where the camera sees ground there."""
        drawn = np.array([[self.focal_px, 0.0, -self.corner[0]], [0.0, self.focal_px, -self.corner[1]], [0.0, 0.0, 1.0]])
        R = self.R_local_view.T @ R_local_cam
        maps = where_seen(model, R, drawn, self.size)
        image = cv2.remap(grey, maps[0], maps[1], cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
        outline = plane_outline(model, R, self.focal_px) - np.array(self.corner)
        seen = np.zeros(self.size[::-1], np.uint8)
        cv2.fillPoly(seen, [np.round(outline * 16).astype(np.int32)], 1, shift=4)
        if model.mask is not None:
            seen &= cv2.remap(ground_of(model), maps[0], maps[1], cv2.INTER_NEAREST, borderValue=0)
        return np.asarray(image, dtype=np.uint8), seen > 0


def level_axes(towards: FloatArray) -> FloatArray:
    """(3, 3) R_local_view: x along a direction, the axis as straight down as that allows, y completing them."""
    x = towards / np.linalg.norm(towards)
    z = DOWN - (DOWN @ x) * x
    z /= np.linalg.norm(z)
    return np.column_stack([x, np.cross(z, x), z])


def plane_outline(model: CameraModel, R_view_cam: FloatArray, focal_px: float) -> FloatArray:
    """(4 EDGE_POINTS, 2) border of a frame on a view's image plane, pixels from the axis; far parts are cut off."""
    w, h, t = model.width_px - 1.0, model.height_px - 1.0, np.arange(EDGE_POINTS) / EDGE_POINTS
    zero, one = np.zeros(EDGE_POINTS), np.ones(EDGE_POINTS)
    u, v = np.concatenate([t * w, one * w, (1 - t) * w, zero]), np.concatenate([zero, t * h, one * h, (1 - t) * h])
    d = unproject(model, np.column_stack([u, v])) @ R_view_cam.T
    across = np.hypot(d[:, 0], d[:, 1])
    depth = np.maximum(d[:, 2], np.maximum(across, 1e-9) / FARTHEST)
    return np.asarray(d[:, :2] / depth[:, None] * focal_px, dtype=np.float64)


def view_of(model: CameraModel, R_local_cam: FloatArray, R_local_view: FloatArray, enlarged: float = 1.0) -> View:
    """The view of all that a frame shows, with the frame's own focal length times a factor."""
    focal = enlarged * float(np.sqrt(model.fx_px * model.fy_px))
    outline = plane_outline(model, R_local_view.T @ R_local_cam, focal)
    low, high = np.floor(outline.min(0)), np.ceil(outline.max(0))
    return View(R_local_view, focal, (float(low[0]), float(low[1])), (int(high[0] - low[0]) + 1, int(high[1] - low[1]) + 1))
