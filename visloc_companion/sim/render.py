"""A camera over a scene: rays through the lens, first hit on the surface, area-correct colours, then the sensor's effects."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from visloc_companion.geo.camera import R_FRD_CAM, unproject
from visloc_companion.geo.raster import apply_affine, invert_affine
from visloc_companion.geo.se3 import R_from_quat
from visloc_companion.sim.rendering.render_effects import AIRLIGHT, NO_EFFECTS, CameraEffects, apply_effects
from visloc_companion.sim.rendering.render_motion import STILL, Shot, row_times_s, smeared, turning
from visloc_companion.sim.rendering.render_rays import Mask, Plane, Rays, hit_levels
from visloc_companion.sim.rendering.render_water import rippled
from visloc_companion.sim.scene import Scene
from visloc_companion.types import CameraModel, GeoPoint, Image, Quat

BLOCK_PX = 32
MIN_DESCENT = 0.03
"""Rays that descend less than this for each unit of length see the sky (they would meet the ground thirty heights away)."""


class CameraSimulator:
    """Renders frames of a scene. Deterministic: the same scene, model, effects, pose and seed give the same pixels.

    The scene's CRS is linearised at the camera for each frame; within a kilometre that is right to a few centimetres.
    """

    def __init__(self, scene: Scene, model: CameraModel, effects: CameraEffects = NO_EFFECTS, water: Mask | None = None) -> None:
        self.scene, self.model, self.effects, self._water = scene, model, effects, water
        self._T_pix_map = invert_affine(scene.T_map_pix)
        v, u = np.mgrid[0 : model.height_px, 0 : model.width_px]
        rays = unproject(model, np.column_stack([u.ravel(), v.ravel()]).astype(np.float64))
        self._rays_cam = np.asarray(rays, dtype=np.float32)
        self._ray_length = np.linalg.norm(self._rays_cam, axis=1).reshape(self._shape)
        self._levels = [scene.pixels]
        self._block_max, self._block_min = _block_extremes(scene.dsm_amsl_m)

    @property
    def _shape(self) -> tuple[int, int]:
        return self.model.height_px, self.model.width_px

    def frame(self, place: GeoPoint, q_ned_frd: Quat, seed: int = 0, shot: Shot = STILL) -> Image:
        """(H, W, 3) RGB seen from a place; `q_ned_frd` is the camera's body (looks down its down axis, top edge forward).

        Place and attitude are those of the middle of the exposure; `shot` tells how the camera moves then. Where `water`
        (H, W of the scene, 255: water) is, waves that no other frame shows hide the ground. Rays that leave the scene or do
        not descend show the colour of hazy air. Raises OutsideMap where the scene's CRS has no coordinates for the place.
        """
        rays, down, seen = self._rays(place, q_ned_frd, shot)
        highest, lowest = self._height_bounds(rays)
        z = hit_levels(self.scene.dsm_amsl_m, rays, highest, lowest)
        u, v = rays.at(z)
        drop = np.float32(place.h_amsl_m) - z
        range_m = drop / down * self._ray_length
        pixels = self._colors(u, v, range_m, down, rays.px_per_m)
        if self._water is not None:
            pixels = rippled(pixels, _share_at(self._water, u, v), seed)
        width, height = self.scene.size_px
        beyond = (u < -0.5) | (v < -0.5) | (u > width - 0.5) | (v > height - 0.5) | ~seen
        if beyond.any():
            pixels[beyond] = AIRLIGHT
        pixels = smeared(pixels, self.model, q_ned_frd, float(np.median(drop)), shot)
        return apply_effects(pixels, range_m, shot.effects or self.effects, seed)

    def _rays(self, place: GeoPoint, q_ned_frd: Quat, shot: Shot) -> tuple[Rays, Plane, NDArray[np.bool_]]:
        """Rays by level, the down component of each (of a ray of unit depth in `cam`), and which of them descend."""
        local = self.scene.projection_at(place)
        base = apply_affine(self._T_pix_map, np.array(local.origin_map_m))
        J_pix_ne = self._T_pix_map[:, :2] @ local.J_map_ne
        t_s = row_times_s(self.model.height_px, shot.readout_s)
        R_ned_cam = turning(R_from_quat(q_ned_frd), shot.rate_frd_radps, t_s) @ R_FRD_CAM
        to_level = np.concatenate([J_pix_ne @ R_ned_cam[:, :2], R_ned_cam[:, 2:]], axis=1).astype(np.float32)
        if len(to_level) == 1:
            parts = to_level[0] @ self._rays_cam.T
        else:
            by_row = self._rays_cam.reshape(*self._shape, 3)
            parts = np.moveaxis(by_row @ to_level.transpose(0, 2, 1), 2, 0)
        u, v, down = (np.ascontiguousarray(part).reshape(self._shape) for part in parts)
        seen = down > MIN_DESCENT * self._ray_length
        down = np.where(seen, down, self._ray_length)
        px_per_m = float(np.sqrt(abs(np.linalg.det(J_pix_ne))))
        moved = base + np.outer(t_s, J_pix_ne @ np.array(shot.v_ned_mps[:2]))
        base_u, base_v = (np.broadcast_to(m, (self.model.height_px, 1)).astype(np.float32) for m in (moved[:, :1], moved[:, 1:]))
        return Rays(base_u, base_v, u / down, v / down, place.h_amsl_m, px_per_m), down, seen

    def _height_bounds(self, rays: Rays) -> tuple[float, float]:
        """Highest and lowest surface under the frame, from blocks of the scene."""
        width, height = self.scene.size_px
        lowest = float(self._block_min.min())
        u, v = rays.every(16).at(min(lowest, rays.camera_h_m - 0.1))
        across = np.clip([min(u.min(), rays.base_u.min()), max(u.max(), rays.base_u.max())], 0, width - 1)
        along = np.clip([min(v.min(), rays.base_v.min()), max(v.max(), rays.base_v.max())], 0, height - 1)
        (c0, c1), (r0, r1) = (across // BLOCK_PX).astype(int), (along // BLOCK_PX).astype(int)
        window = (slice(max(r0 - 1, 0), r1 + 2), slice(max(c0 - 1, 0), c1 + 2))
        return float(self._block_max[window].max()), float(self._block_min[window].min())

    def _colors(self, u: Plane, v: Plane, range_m: Plane, down: Plane, px_per_m: float) -> Image:
        """Colours at scene pix, from the pyramid level that fits the ground covered by each pixel (bilinear between levels)."""
        covered = range_m * np.float32(px_per_m / np.sqrt(self.model.fx_px * self.model.fy_px))
        covered *= cv2.sqrt(self._ray_length / down)
        level = np.log2(np.maximum(covered, 1.0))
        first, last = int(level.min()), int(np.ceil(level.max() - 0.02))
        if last == 0:
            return _colors_at(self.scene.pixels, u, v, cv2.INTER_CUBIC)
        total = np.zeros((*self._shape, 3), np.float32)
        for k in range(first, last + 1):
            weight = np.clip(1 - np.abs(level - np.float32(k)), 0, 1)
            scale = np.float32(2.0**-k)
            colors = _colors_at(self._level(k), (u + 0.5) * scale - 0.5, (v + 0.5) * scale - 0.5, cv2.INTER_LINEAR)
            total += weight[:, :, None] * colors
        return np.asarray(np.clip(total + 0.5, 0, 255), dtype=np.uint8)

    def _level(self, k: int) -> Image:
        while len(self._levels) <= k:
            finer = self._levels[-1]
            even = finer[: max(1, finer.shape[0] // 2 * 2), : max(1, finer.shape[1] // 2 * 2)]
            size = (max(1, even.shape[1] // 2), max(1, even.shape[0] // 2))
            self._levels.append(np.asarray(cv2.resize(even, size, interpolation=cv2.INTER_AREA), dtype=np.uint8))
        return self._levels[k]


def _colors_at(layer: Image, u: Plane, v: Plane, interpolation: int) -> Image:
    return np.asarray(cv2.remap(layer, u, v, interpolation, borderMode=cv2.BORDER_REPLICATE), dtype=np.uint8)


def _share_at(mask: Mask, u: Plane, v: Plane) -> Plane:
    """How much of each pixel a mask of the scene covers, 0 to 1; none of what lies beyond the scene."""
    seen = cv2.remap(mask, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=0)
    return np.asarray(seen, dtype=np.float32) / np.float32(255)


def _block_extremes(dsm_m: Plane) -> tuple[Plane, Plane]:
    """Highest and lowest of each block of BLOCK_PX x BLOCK_PX pixels (the last ones are smaller)."""
    rows, columns = (np.arange(0, n, BLOCK_PX) for n in dsm_m.shape)
    highest = np.maximum.reduceat(np.maximum.reduceat(dsm_m, rows, axis=0), columns, axis=1)
    lowest = np.minimum.reduceat(np.minimum.reduceat(dsm_m, rows, axis=0), columns, axis=1)
    return highest, lowest
