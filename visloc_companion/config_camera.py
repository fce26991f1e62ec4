"""Section `camera` of the configuration, which is also what the camera.toml of a recorded flight holds."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, ValidationInfo, field_validator, model_validator

from visloc_companion.config_section import NonNegative, Positive, Section
from visloc_companion.types import DISTORTION_COEFFICIENTS, DistortionModel

Lever = Annotated[float, Field(ge=-20, le=20)]
MOST_OWN_GIMBALS = 6
"""GIMBAL_DEVICE_ATTITUDE_STATUS.gimbal_device_id of gimbals without a MAVLink component of their own."""
GIMBAL_COMPONENTS = frozenset((154, *range(171, 176)))
"""MAV_COMP_ID_GIMBAL, and GIMBAL2 to GIMBAL6."""
LENS_KEYS = ("width_px", "height_px", "fx_px", "fy_px", "cx_px", "cy_px")
"""What frames are placed by: assumed, they lie off by as much as the assumption is wrong."""
OF_GIMBALS = ("gimbal_id", "gimbal_frame", "gimbal_yaw_sigma_deg")


class CameraConfig(Section):
    """The camera and how it is mounted. Where `url` names one, size and lens (`width_px` to `cy_px`) have to be stated."""

    url: str = ""
    """`files:FOLDER` (with frames.csv), `video:FILE`, `device:/dev/video0` or `tcp:HOST:PORT` (length-prefixed frames)."""
    width_px: Annotated[int, Field(ge=64, le=10000)] = 640
    """Width of the calibrated image; frames of another size are refused. Size and lens are what `visloc calibrate` writes."""
    height_px: Annotated[int, Field(ge=48, le=10000)] = 480
    """Height of the calibrated image."""
    fx_px: Positive = 500.0
    """Focal length along the columns."""
    fy_px: Positive = 500.0
    """Focal length along the rows."""
    cx_px: NonNegative = 319.5
    """Principal point, column (centre of the top-left pixel is 0)."""
    cy_px: NonNegative = 239.5
    """Principal point, row."""
    distortion_model: DistortionModel = "brown_conrady"
    """How the lens bends: `brown_conrady` (ROS: plumb_bob), `rational` (rational_polynomial) or `fisheye` (equidistant)."""
    distortion: Annotated[tuple[float, ...], Field(validate_default=True)] = (0.0, 0.0, 0.0, 0.0, 0.0)
    """As OpenCV writes them: k1 k2 p1 p2 k3; `rational` k1 k2 p1 p2 k3 k4 k5 k6; `fisheye` k1 k2 k3 k4."""
    mount: Literal["fixed", "gimbal"] = "fixed"
    """What carries the camera: the airframe, or a gimbal, whose attitude is then asked of the autopilot (docs/on-a-drone.md,
    Gimbal)."""
    gimbal_id: Annotated[int, Field(ge=0, le=255)] = 0
    """Of several gimbals, the one that carries the camera: 1 to 6 as the autopilot counts its own, or the MAVLink component of
    one that speaks MAVLink itself (154, 171 to 175). 0: the first that is heard."""
    gimbal_frame: Literal["auto", "airframe", "heading", "north"] = "auto"
    """What its attitude counts from: as its messages say; the airframe (servos: ArduPilot's `MNT1_TYPE` 1); the horizon and the
    vehicle's heading; the horizon and north."""
    gimbal_yaw_sigma_deg: Annotated[float, Field(ge=0, le=30)] = 3.0
    """1-sigma of the yaw that a gimbal states, beside the heading's."""
    mount_roll_deg: float = 0.0
    """Roll of the camera's body in the body of what carries it."""
    mount_pitch_deg: float = 0.0
    """Pitch of the camera's body in that body; positive lifts the top edge of the image."""
    mount_yaw_deg: float = 0.0
    """Yaw of the camera's body in that body. All zero: on the airframe it looks down with the image's top edge forward, on a
    gimbal where the gimbal points, top edge up."""
    lever_arm_frd_m: tuple[Lever, Lever, Lever] = (0.0, 0.0, 0.0)
    """The camera (the joint of its gimbal) in the vehicle's body: metres forward, right and down of the autopilot's IMU."""
    mount_sigma_deg: Positive = 1.0
    """1-sigma of the mounting and attitude together (on a gimbal: of its attitude), as the localiser's prior of tilt."""
    mask: str = ""
    """8-bit PNG of the image's size, black where the camera sees its own vehicle or the lens's rim, white where it sees ground
    (docs/on-a-drone.md, Mask); relative to the file that names it. Empty: ground everywhere."""
    mask_sha256: Annotated[str, Field(pattern=r"^([0-9a-f]{64})?$")] = ""
    """SHA-256 of that file; where it is not stated, that of the file as it is at the start, which journals keep."""
    latency_s: Annotated[float, Field(ge=0, le=5)] = 0.0
    """Seconds from mid-exposure to arrival, where the camera gives no time stamp. What is 6 s old is of no use to the filter."""
    readout_ms: Annotated[float, Field(ge=-200, le=200)] = 0.0
    """Time from the first row of an image to the last where the shutter rolls (often 10 to 40 ms; the sensor's data sheet says);
    negative where the image is turned upside down after it was read. Frames count from their middle row."""

    @property
    def unstated(self) -> list[str]:
        """Those of LENS_KEYS that nobody stated and that have their defaults."""
        return [key for key in LENS_KEYS if key not in self.model_fields_set]

    @field_validator("distortion")
    @classmethod
    def _as_many_as_the_model_has(cls, values: tuple[float, ...], info: ValidationInfo) -> tuple[float, ...]:
        model = info.data.get("distortion_model")
        if model is not None and len(values) != len(DISTORTION_COEFFICIENTS[model]):
            names = DISTORTION_COEFFICIENTS[model]
            raise ValueError(f"{len(values)} coefficients, but distortion_model {model!r} has {len(names)}: {' '.join(names)}")
        return values

    @field_validator("gimbal_id")
    @classmethod
    def _names_a_gimbal(cls, value: int) -> int:
        if value > MOST_OWN_GIMBALS and value not in GIMBAL_COMPONENTS:
            components = ", ".join(map(str, sorted(GIMBAL_COMPONENTS)))
            raise ValueError(f"not 0 (the first), 1 to {MOST_OWN_GIMBALS} (the autopilot's own) or a component ({components})")
        return value

    @model_validator(mode="after")
    def _a_fixed_camera_has_no_gimbal(self) -> CameraConfig:
        fields = type(self).model_fields
        stated = [name for name in OF_GIMBALS if getattr(self, name) != fields[name].default]
        if self.mount == "fixed" and stated:
            raise ValueError(f'{", ".join(stated)} without a gimbal: set mount = "gimbal", or leave out what is about one')
        return self
