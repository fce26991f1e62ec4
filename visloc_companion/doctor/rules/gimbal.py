"""The gimbal that carries the camera, or one that nobody told the daemon of."""

from __future__ import annotations

from visloc_companion.config_camera import CameraConfig
from visloc_companion.doctor.facts import Facts, GimbalHeard
from visloc_companion.doctor.finding import Finding, Rule, amber, green, red, skipped
from visloc_companion.doctor.rules.camera import configured
from visloc_companion.types import AutopilotKind

ENOUGH_HZ = 10.0
FIXED = "the camera is fixed to the airframe"
SERVO, SOLO, STORM32_MAVLINK, BRUSHLESS_PWM, CADDX = 1, 2, 4, 7, 13
"""MNTn_TYPE of ArduPilot."""
TOLD_ONLY = (SERVO, SOLO, STORM32_MAVLINK, BRUSHLESS_PWM, CADDX)
"""Of these ArduPilot states where they were told to point (get_attitude_quaternion of AP_Mount_Servo.cpp and its like)."""
MOUNT1_ROLL, MOUNT2_ROLL = 8, 14
"""SERVOn_FUNCTION of a gimbal's roll servo."""
AUX_OUTPUT, STABILISES_PITCH_ONLY = 0, 3
"""MNT_MODE_OUT and MNT_DO_STAB of PX4 (gimbal/common.h)."""


def _type_of(camera: CameraConfig, facts: Facts) -> tuple[str, int]:
    """Name (before 4.3 that of the first had no number) and value of ArduPilot's parameter of the gimbal's type; 0: none."""
    names = ("MNT2_TYPE",) if camera.gimbal_id == 2 else ("MNT1_TYPE", "MNT_TYPE")
    name = next((name for name in names if name in facts.parameters), names[0])
    return name, int(facts.parameters.get(name, 0))


def _configured_in(camera: CameraConfig, facts: Facts) -> str:
    """The autopilot's parameter that tells of a gimbal; empty where none does."""
    if facts.autopilot is AutopilotKind.ARDUPILOT:
        name, kind = _type_of(camera, facts)
        return f"{name} = {kind}" if kind else ""
    mode = facts.parameters.get("MNT_MODE_IN", -1.0)
    return f"MNT_MODE_IN = {mode:.0f}" if facts.autopilot is AutopilotKind.PX4 and mode >= 0 else ""


def _heard(camera: CameraConfig, facts: Facts) -> list[GimbalHeard]:
    """What the gimbal that carries the camera, or any where none is chosen, said of itself."""
    all_heard = () if facts.link is None else facts.link.gimbals
    return [one for one in all_heard if camera.gimbal_id in (0, one.gimbal_id)]


@configured(
    "camera-gimbal",
    "camera.mount, MNT1_TYPE, MNT_MODE_IN, GIMBAL_DEVICE_ATTITUDE_STATUS",
    "A camera that a gimbal carries and that counts as fixed is looked for with the airframe's attitude, where it does not look.",
    'if it carries the camera, camera.mount = "gimbal"; if it carries another one, nothing',
)
def _unknown(camera: CameraConfig, facts: Facts) -> Finding:
    if camera.mount == "gimbal":
        return green('camera.mount = "gimbal"')
    named, heard = _configured_in(camera, facts), _heard(camera, facts)
    if named or heard or (facts.link is not None and facts.link.old_gimbal):
        message = "GIMBAL_DEVICE_ATTITUDE_STATUS comes" if heard else "MOUNT_ORIENTATION comes"
        return amber(f'{named or message}, camera.mount = "fixed"')
    return green('camera.mount = "fixed", and no gimbal is heard of')


@configured(
    "camera-gimbal-rate",
    "GIMBAL_DEVICE_ATTITUDE_STATUS",
    "Frames are used only where it is known within 0.1 s of them where the gimbal points.",
    "ArduPilot: MNT1_TYPE of your gimbal; PX4: MNT_MODE_IN and MNT_MODE_OUT; a gimbal that speaks MAVLink itself: 20 Hz in its "
    "own settings; camera.gimbal_id of the gimbal that carries the camera",
)
def _rate(camera: CameraConfig, facts: Facts) -> Finding:
    if camera.mount == "fixed":
        return green(FIXED)
    if facts.link is None:
        return skipped("no autopilot was read", "connect it, and name it in link.url")
    heard = _heard(camera, facts)
    others = ", ".join(str(one.gimbal_id) for one in facts.link.gimbals)
    if not heard:
        return red(f"no gimbal {camera.gimbal_id} says where it points (heard: {others or 'none'})")
    best = max(heard, key=lambda one: one.rate_hz)
    read = f"{best.rate_hz:.1f} Hz of gimbal {best.gimbal_id}"
    return green(read) if best.rate_hz >= ENOUGH_HZ else amber(read)


@configured(
    "camera-gimbal-frame",
    "GIMBAL_DEVICE_ATTITUDE_STATUS.flags, MNT1_TYPE, MNT_MODE_OUT, MNT_DO_STAB, camera.gimbal_frame",
    "What its angles count from decides where the camera looks: the airframe's lean, or its heading, is added or not.",
    'camera.gimbal_frame = "heading", "north" or "airframe", as the gimbal\'s manual says (docs/on-a-drone.md, Gimbal)',
)
def _frame(camera: CameraConfig, facts: Facts) -> Finding:
    if camera.mount == "fixed":
        return green(FIXED)
    servos = _servos(camera, facts)
    if servos is not None:
        return servos
    heard = _heard(camera, facts)
    if not heard:
        return skipped("no gimbal says where it points", "see camera-gimbal-rate")
    if camera.gimbal_frame == "auto" and any(not one.frames for one in heard):
        return red("both frames of yaw at once, which is not allowed")
    frames = sorted({frame for one in heard for frame in one.frames})
    if camera.gimbal_frame == "auto" and len(frames) > 1:
        return amber(f"{' and '.join(frames)} by turns")
    return green(" and ".join(frames) if camera.gimbal_frame == "auto" else f'camera.gimbal_frame = "{camera.gimbal_frame}"')


def _servos(camera: CameraConfig, facts: Facts) -> Finding | None:
    """Gimbals of which the autopilot states the angles of servos, about the airframe whatever its flags say."""
    name, kind = _type_of(camera, facts)
    parameters = facts.parameters
    pitch_only = parameters.get("MNT_DO_STAB") == STABILISES_PITCH_ONLY and parameters.get("MNT_MODE_OUT") == AUX_OUTPUT
    if facts.autopilot is AutopilotKind.ARDUPILOT and kind == SERVO:
        read = f"{name} = {SERVO}: servos, whose angles count from the airframe"
    elif facts.autopilot is AutopilotKind.PX4 and pitch_only:
        read = f"MNT_DO_STAB = {STABILISES_PITCH_ONLY}: a servo, whose angle counts from the airframe"
    else:
        return None
    rolls = {value for key, value in parameters.items() if key.startswith("SERVO") and key.endswith("_FUNCTION")}
    if rolls & {MOUNT1_ROLL, MOUNT2_ROLL}:
        why = "with a servo for the roll their order is not stated, and the camera may look degrees beside"
        return red(f"{read}; {why}", "a gimbal that stabilises itself and states how it points, or a camera that is fixed")
    if camera.gimbal_frame != "airframe":
        return red(read, 'camera.gimbal_frame = "airframe"')
    return green(read)


@configured(
    "camera-gimbal-measured",
    "MNT1_TYPE, MNT_MODE_OUT",
    "Where it was told to point is not where it points while it turns, at its limits, or when it has lost its horizon.",
    "a gimbal whose driver reads its angles (Siyi, Gremsy, Viewpro, Xacti, SToRM32 over its serial protocol); else do not turn "
    "it in flight, and state what it errs by in camera.mount_sigma_deg",
)
def _measured(camera: CameraConfig, facts: Facts) -> Finding:
    if camera.mount == "fixed":
        return green(FIXED)
    if not facts.parameters:
        return skipped("no parameters were read", "connect the autopilot, and name it in link.url")
    if facts.autopilot is AutopilotKind.PX4:
        output = facts.parameters.get("MNT_MODE_OUT")
        told_only = output == AUX_OUTPUT
        read = "MNT_MODE_OUT is unknown" if output is None else f"MNT_MODE_OUT = {output:.0f}"
    else:
        name, kind = _type_of(camera, facts)
        told_only, read = kind in TOLD_ONLY, f"{name} = {kind}"
    return amber(f"{read}: it is stated where the gimbal was told to point") if told_only else green(read)


RULES: tuple[Rule, ...] = (_unknown, _rate, _frame, _measured)
"""About gimbals."""
