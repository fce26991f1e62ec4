"""The camera: its configuration, and what it gave."""

from __future__ import annotations

import math
from collections.abc import Callable

from visloc_companion.adapters.camera.calibration import camera_model, lens_model, masked_share
from visloc_companion.config_camera import LENS_KEYS, CameraConfig
from visloc_companion.doctor.facts import CameraFacts, Facts
from visloc_companion.doctor.finding import Finding, Rule, amber, green, red, skipped
from visloc_companion.errors import ConfigError
from visloc_companion.geo.pinhole_view import field_of_view_deg, inner_reach, pinhole_view

JudgeSeen = Callable[[CameraFacts, Facts], Finding]
JudgeConfigured = Callable[[CameraConfig, Facts], Finding]
NARROWEST_DEG, WIDEST_DEG = 15.0, 110.0
MAX_ASPECT, MAX_OFF_CENTRE, MAX_TILT_DEG = 0.05, 0.15, 45.0
MAX_DARK, MAX_BRIGHT, MAX_UNLIT, MAX_STILL = 0.5, 0.3, 0.05, 0.003
ENOUGH = 0.7


def configured(rule_id: str, reads: str, why: str, remedy: str) -> Callable[[JudgeConfigured], Rule]:
    """Decorator: a rule about the section camera of a configuration that names a camera."""

    def make(judge: JudgeConfigured) -> Rule:
        def check(facts: Facts) -> Finding:
            if facts.config is None:
                return skipped("no configuration", "give --config FILE")
            if not facts.config.camera.url:
                return skipped("camera.url is empty", "name the camera in the configuration")
            return judge(facts.config.camera, facts)

        return Rule(rule_id, reads, why, remedy, check)

    return make


def seen(rule_id: str, reads: str, why: str, remedy: str) -> Callable[[JudgeSeen], Rule]:
    """Decorator: a rule about the frames of a camera that works."""

    def make(judge: JudgeSeen) -> Rule:
        def check(facts: Facts) -> Finding:
            if facts.camera is None or facts.camera.problem:
                return skipped("no frames", "give --config FILE with a camera, and see camera-opens")
            return judge(facts.camera, facts)

        return Rule(rule_id, reads, why, remedy, check)

    return make


def _is_device(camera: CameraConfig) -> bool:
    return camera.url.startswith("device:")


def _opens(facts: Facts) -> Finding:
    if facts.camera is None:
        return skipped("no camera was tried", "give --config FILE with camera.url")
    return red(facts.camera.problem) if facts.camera.problem else green(f"{facts.camera.n_frames} frames")


@seen(
    "camera-rate",
    "frames a second",
    "Fewer frames than localisations that are asked for leave the worker idle.",
    "the camera's own frame rate, exposure below 1/rate, a faster bus; or localiser.max_rate_hz",
)
def _rate(camera: CameraFacts, facts: Facts) -> Finding:
    wanted = facts.assumed.localiser.max_rate_hz
    read = f"{camera.rate_hz:.1f} frames/s, localiser.max_rate_hz = {wanted:g}"
    return green(read) if camera.rate_hz >= ENOUGH * wanted else amber(read)


@seen(
    "camera-exposure",
    "grey values of the frames",
    "Black and white pixels carry nothing that could be matched.",
    "exposure: automatic, or a fixed time that suits the light; 3 ms keep a turn of 30°/s within a pixel of a 640-pixel image",
)
def _exposure(camera: CameraFacts, facts: Facts) -> Finding:
    del facts
    read = f"{100 * camera.dark:.0f} % black, {100 * camera.bright:.0f} % white"
    return green(read) if camera.dark <= MAX_DARK and camera.bright <= MAX_BRIGHT else amber(read)


@seen(
    "camera-frozen",
    "successive frames",
    "A camera that repeats its picture gives fixes of where it was taken.",
    "open the camera again, look for what else uses it (fuser /dev/video0), replace the cable",
)
def _frozen(camera: CameraFacts, facts: Facts) -> Finding:
    del facts
    read = f"{100 * camera.repeated:.0f} % of the frames repeat the one before"
    return green(read) if camera.repeated < 0.5 else red(read)


@seen(
    "camera-rim",
    "what is black in every frame",
    "A rim that the lens leaves black stands still whatever the ground does: fewer fixes, and turns that are wrong.",
    "paint it black in the mask that camera.mask names (docs/on-a-drone.md, Mask); or a lens whose image covers the sensor",
)
def _rim(camera: CameraFacts, facts: Facts) -> Finding:
    del facts
    read = f"{100 * camera.unlit:.0f} % of what is looked at stay black"
    return green(read) if camera.unlit <= MAX_UNLIT else amber(read)


@seen(
    "camera-still",
    "what stands still in every frame while the rest moves",
    "Text of a video link, gear or dead lines are followed as if they were ground that does not move: motion and turns err.",
    "switch the text off at the camera; paint black what stays in the mask that camera.mask names (docs/on-a-drone.md, Mask)",
)
def _still(camera: CameraFacts, facts: Facts) -> Finding:
    del facts
    if camera.still is None:
        return skipped(
            "the picture did not move", 'move the vehicle meanwhile, or examine frames of a flight (camera.url = "files:FOLDER")'
        )
    read = f"{100 * camera.still:.1f} % of what is looked at stand still while the rest moves"
    return green(read) if camera.still <= MAX_STILL else amber(read)


@configured(
    "camera-mask",
    "camera.mask",
    "Landing gear, guards or a gimbal in view stand still while the ground moves: fewer fixes, and turns that are wrong.",
    "what it says; docs/on-a-drone.md, Mask, tells how to make one",
)
def _mask(camera: CameraConfig, facts: Facts) -> Finding:
    del facts
    if not camera.mask:
        return green("names no file: all of the picture is taken for ground")
    try:
        return green(f"{100 * masked_share(camera_model(camera)):.0f} % of what is looked at are masked")
    except ConfigError as why:
        return red(f"{why.where}: {why.what}")


@configured(
    "camera-focal-length",
    "camera.fx_px camera.width_px",
    "A focal length that is wrong by 1 % is a height that is wrong by 1 %; a wild one matches nothing.",
    "visloc calibrate at this image size, and write fx_px and fy_px (docs/on-a-drone.md, Calibration)",
)
def _focal(camera: CameraConfig, facts: Facts) -> Finding:
    del facts
    if camera.distortion_model != "brown_conrady":
        return _wide(camera)
    angle_deg = math.degrees(2 * math.atan(camera.width_px / 2 / camera.fx_px))
    read = f"{angle_deg:.0f}° across {camera.width_px} px"
    return green(read) if NARROWEST_DEG <= angle_deg <= WIDEST_DEG else red(read)


def _wide(camera: CameraConfig) -> Finding:
    """What a rational or fisheye lens sees, and how much of that is looked at."""
    try:
        model = lens_model(camera)
    except ConfigError as why:
        return skipped(why.what, "see camera-lens")
    (across_deg, down_deg), (kept_across_deg, kept_down_deg) = field_of_view_deg(model), field_of_view_deg(pinhole_view(model))
    read = f"{across_deg:.0f} x {down_deg:.0f}°, the inner {kept_across_deg:.0f} x {kept_down_deg:.0f}° are looked at"
    return green(read) if across_deg >= NARROWEST_DEG else red(read)


@configured(
    "camera-lens",
    "camera.distortion_model camera.distortion",
    "A mapping that folds back within the picture is none of a lens: coefficients in another order, or of another model.",
    "check distortion_model, order and signs; visloc calibrate, with views that reach into the corners",
)
def _lens(camera: CameraConfig, facts: Facts) -> Finding:
    del facts
    try:
        reach = inner_reach(lens_model(camera))
    except ConfigError as why:
        return red(why.what)
    if math.isinf(reach):
        return green(f"{camera.distortion_model}, never folds")
    read = f"{camera.distortion_model}, folds at {100 * reach:.0f} % of the way to the nearest border"
    return green(read) if reach >= 1.0 else red(read)


@configured(
    "camera-aspect",
    "camera.fx_px camera.fy_px",
    "Square pixels have fx = fy; another ratio is a calibration of a scaled image.",
    "calibrate at the size that the daemon gets",
)
def _aspect(camera: CameraConfig, facts: Facts) -> Finding:
    del facts
    read = f"fy/fx = {camera.fy_px / camera.fx_px:.3f}"
    return green(read) if abs(camera.fy_px / camera.fx_px - 1) <= MAX_ASPECT else amber(read)


@configured(
    "camera-principal-point",
    "camera.cx_px camera.cy_px",
    "Far from the middle it belongs to another image size: half the size gives half the values.",
    "calibrate at the size that the daemon gets; the centre of the top-left pixel is 0, 0",
)
def _principal(camera: CameraConfig, facts: Facts) -> Finding:
    del facts
    off = math.hypot(
        (camera.cx_px - (camera.width_px - 1) / 2) / camera.width_px,
        (camera.cy_px - (camera.height_px - 1) / 2) / camera.height_px,
    )
    read = f"{camera.cx_px:g}, {camera.cy_px:g} of {camera.width_px} x {camera.height_px}"
    return green(read) if off <= MAX_OFF_CENTRE else red(read)


@configured(
    "camera-calibrated",
    "camera.distortion camera.fx_px",
    "The defaults are no calibration of any camera.",
    "visloc calibrate (25 pictures of a printed board), and write its fx_px, fy_px, cx_px, cy_px and distortion",
)
def _calibrated(camera: CameraConfig, facts: Facts) -> Finding:
    del facts
    if camera.unstated:
        return red(f"{', '.join(camera.unstated)} not stated: the daemon does not start")
    default = CameraConfig()
    if all(getattr(camera, key) == getattr(default, key) for key in LENS_KEYS):  # a real lens may well have one of them
        return red(f"fx_px = {camera.fx_px:g} and all else of the lens are the defaults")
    real = _is_device(camera)
    bare = real and camera.distortion_model == "brown_conrady" and not any(camera.distortion)
    return amber("distortion is all zero") if bare else green("fx_px and distortion are stated" if real else "fx_px is stated")


@configured(
    "camera-latency",
    "camera.latency_s",
    "Frames of a device carry no time: without their latency they are placed too late on the track.",
    "film a clock that the computer displays, and set camera.latency_s to the difference (30 to 100 ms are usual)",
)
def _latency(camera: CameraConfig, facts: Facts) -> Finding:
    del facts
    read = f"camera.latency_s = {camera.latency_s:g}"
    unstated = _is_device(camera) and camera.latency_s == 0
    if camera.latency_s > 0.5:
        return red(f"{read}: send the newest frame, not what waits in a buffer")
    return amber(read) if unstated else green(read)


@configured(
    "camera-readout",
    "camera.readout_ms",
    "Most small cameras expose their rows one after another: turns bend the picture, and positions are off by metres.",
    "set camera.readout_ms to the time from the first row to the last (the sensor's data sheet), or to 0 for a global shutter",
)
def _readout(camera: CameraConfig, facts: Facts) -> Finding:
    del facts
    unstated = _is_device(camera) and "readout_ms" not in camera.model_fields_set
    return amber("camera.readout_ms is not stated") if unstated else green(f"camera.readout_ms = {camera.readout_ms:g}")


@configured(
    "camera-mounting",
    "camera.mount_*_deg",
    "Beyond 45° from straight down the horizon comes into view, and little ground is matched.",
    "mount the camera straight down, or correct mount_roll_deg and mount_pitch_deg",
)
def _mounting(camera: CameraConfig, facts: Facts) -> Finding:
    del facts
    roll, pitch = math.radians(camera.mount_roll_deg), math.radians(camera.mount_pitch_deg)
    tilt_deg = math.degrees(math.acos(max(-1.0, min(1.0, math.cos(roll) * math.cos(pitch)))))
    straight = "straight down" if camera.mount == "fixed" else "where its gimbal points"
    read = f"{tilt_deg:.0f}° from {straight}, yaw {camera.mount_yaw_deg:g}°"
    return green(read) if tilt_deg <= MAX_TILT_DEG else red(read)


@configured(
    "camera-mount-sigma",
    "camera.mount_sigma_deg",
    "Near 0 it claims a perfect mounting: honest fixes are then refused; far above 3° the search gets wide and slow.",
    "mount_sigma_deg = 1 (2.1 m at 120 m above ground)",
)
def _sigma(camera: CameraConfig, facts: Facts) -> Finding:
    del facts
    read = f"{camera.mount_sigma_deg:g}°"
    return green(read) if 0.2 <= camera.mount_sigma_deg <= 5 else amber(read)


RULES: tuple[Rule, ...] = (
    Rule(
        "camera-opens",
        "camera.url",
        "Without frames, of the calibrated size, there is nothing to localise.",
        "what it says: name, cable, group video, another program, or section camera",
        _opens,
    ),
    _rate,
    _exposure,
    _frozen,
    _rim,
    _still,
    _mask,
    _focal,
    _lens,
    _aspect,
    _principal,
    _calibrated,
    _latency,
    _readout,
    _mounting,
    _sigma,
)
"""About the camera."""
