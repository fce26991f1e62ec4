"""Rotations and quaternions (Hamilton, wxyz, w >= 0). `R_a_b` maps b-coordinates to a; angles in radians."""

from __future__ import annotations

import math

import numpy as np

from visloc_companion.types import FloatArray, Quat, Vec3


def wrap_pi(angle_rad: float) -> float:
    """The same angle in (-pi, pi]."""
    return math.pi - (math.pi - angle_rad) % (2 * math.pi)


def normalised(q: Quat) -> Quat:
    """Unit quaternion with w >= 0. Raises ValueError for a zero or non-finite quaternion."""
    w, x, y, z = q
    norm = math.sqrt(w * w + x * x + y * y + z * z)
    if not (math.isfinite(norm) and norm > 1e-9):
        raise ValueError(f"not a quaternion: {q}")
    if w < 0:
        norm = -norm
    return w / norm, x / norm, y / norm, z / norm


def quat_multiply(a: Quat, b: Quat) -> Quat:
    """Hamilton product: `q_a_c = quat_multiply(q_a_b, q_b_c)`."""
    (aw, ax, ay, az), (bw, bx, by, bz) = a, b
    return normalised(
        (
            aw * bw - ax * bx - ay * by - az * bz,
            aw * bx + ax * bw + ay * bz - az * by,
            aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw,
        )
    )


def quat_inverse(q: Quat) -> Quat:
    """Conjugate of a unit quaternion: `q_b_a` from `q_a_b`."""
    return (q[0], -q[1], -q[2], -q[3])


def quat_from_euler(roll_rad: float, pitch_rad: float, yaw_rad: float) -> Quat:
    """`q_ned_frd` from aerospace angles (intrinsic yaw, pitch, roll)."""
    cr, cp, cy = (math.cos(a / 2) for a in (roll_rad, pitch_rad, yaw_rad))
    sr, sp, sy = (math.sin(a / 2) for a in (roll_rad, pitch_rad, yaw_rad))
    return normalised(
        (
            cr * cp * cy + sr * sp * sy,
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
        )
    )


def quat_from_vector(turn_rad: Vec3) -> Quat:
    """The rotation about a vector by its length, radians."""
    x, y, z = turn_rad
    angle = math.sqrt(x * x + y * y + z * z)
    k = 0.5 if angle < 1e-9 else math.sin(angle / 2) / angle
    return normalised((math.cos(angle / 2), k * x, k * y, k * z))


def vector_from_quat(q: Quat) -> Vec3:
    """The rotation vector (rad) of a quaternion, at most pi long."""
    sign = 1.0 if q[0] >= 0 else -1.0
    x, y, z = (sign * part for part in q[1:])
    sine = math.sqrt(x * x + y * y + z * z)
    share = 2.0 if sine < 1e-12 else 2 * math.atan2(sine, abs(q[0])) / sine
    return share * x, share * y, share * z


def body_rates(q_before: Quat, q_after: Quat, dt_s: float) -> Vec3:
    """Mean angular velocity (rad/s, body axes) that turns one `q_ned_frd` into the next within `dt_s`."""
    x, y, z = vector_from_quat(quat_multiply(quat_inverse(q_before), q_after))
    return x / dt_s, y / dt_s, z / dt_s


def euler_from_quat(q: Quat) -> Vec3:
    """Roll, pitch, yaw (radians) of `q_ned_frd`."""
    w, x, y, z = q
    roll = math.atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
    pitch = math.asin(max(-1.0, min(1.0, 2 * (w * y - z * x))))
    yaw = math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    return roll, pitch, yaw


def R_from_quat(q: Quat) -> FloatArray:
    """(3, 3) rotation matrix `R_a_b` of `q_a_b`."""
    w, x, y, z = q
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def down_axis(q: Quat) -> Vec3:
    """The third column of `R_from_quat`, as plain numbers: where the down axis of b points in a."""
    w, x, y, z = q
    return 2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)


def quat_from_R(R: FloatArray) -> Quat:
    """Unit quaternion of a rotation matrix (Shepperd's method)."""
    trace = float(np.trace(R))
    candidates = (trace, float(R[0, 0]), float(R[1, 1]), float(R[2, 2]))
    largest = candidates.index(max(candidates))
    if largest == 0:
        w = math.sqrt(1 + trace) / 2
        return normalised((w, (R[2, 1] - R[1, 2]) / (4 * w), (R[0, 2] - R[2, 0]) / (4 * w), (R[1, 0] - R[0, 1]) / (4 * w)))
    i = largest - 1
    j, k = (i + 1) % 3, (i + 2) % 3
    s = math.sqrt(1 + R[i, i] - R[j, j] - R[k, k]) * 2
    q = [float(R[k, j] - R[j, k]) / s, 0.0, 0.0, 0.0]
    q[i + 1], q[j + 1], q[k + 1] = s / 4, float(R[j, i] + R[i, j]) / s, float(R[k, i] + R[i, k]) / s
    return normalised((q[0], q[1], q[2], q[3]))


def slerp(a: Quat, b: Quat, share: float) -> Quat:
    """Spherical interpolation from a (share 0) to b (share 1) along the shorter arc."""
    dot = a[0] * b[0] + a[1] * b[1] + a[2] * b[2] + a[3] * b[3]
    if dot < 0:
        b, dot = (-b[0], -b[1], -b[2], -b[3]), -dot
    if dot > 0.9999995:
        wa, wb = 1 - share, share
    else:
        angle = math.acos(min(1.0, dot))
        wa, wb = math.sin((1 - share) * angle) / math.sin(angle), math.sin(share * angle) / math.sin(angle)
    return normalised((wa * a[0] + wb * b[0], wa * a[1] + wb * b[1], wa * a[2] + wb * b[2], wa * a[3] + wb * b[3]))


def rotate(q: Quat, v: Vec3) -> Vec3:
    """The vector in a of a vector in b, for `q_a_b`."""
    (w, x, y, z), (a, b, c) = q, v
    return (
        (1 - 2 * (y * y + z * z)) * a + 2 * (x * y - w * z) * b + 2 * (x * z + w * y) * c,
        2 * (x * y + w * z) * a + (1 - 2 * (x * x + z * z)) * b + 2 * (y * z - w * x) * c,
        2 * (x * z - w * y) * a + 2 * (y * z + w * x) * b + (1 - 2 * (x * x + y * y)) * c,
    )


def plus(a: Vec3, b: Vec3) -> Vec3:
    """The sum of two vectors in the same axes."""
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


def angle_between(a: Quat, b: Quat) -> float:
    """Angle of the rotation from one attitude to the other, radians in [0, pi]."""
    dot = abs(sum(x * y for x, y in zip(a, b, strict=True)))
    return 2 * math.acos(min(1.0, dot))
