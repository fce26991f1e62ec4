"""As published: raw irregular points, FPFH features, RANSAC on their correspondences, ICP; by Open3D (the extra `open3d`).

Rusu, Blodow and Beetz 2009; Fischler and Bolles 1981; Zhou, Park and Koltun 2018. This is the only importing room of Open3D. Its
RANSAC draws from a seeded generator: the same answer again where the process has one OpenMP thread (OMP_NUM_THREADS=1).
"""

from __future__ import annotations

from functools import partial
from types import ModuleType
from typing import Any

import numpy as np

from visloc_companion.errors import ConfigError
from visloc_companion.localise.registration.base import NotRegistered, Registered, RegistrationPrior
from visloc_companion.localise.registration.settle import judged
from visloc_companion.types import FloatArray

VOXEL_M = 1.5
NORMAL_VOXELS, FEATURE_VOXELS, MATCH_VOXELS, FINE_VOXELS = 2.0, 5.0, 1.5, 1.0
"""Radii of normals and features; largest distance of a correspondence in RANSAC and ICP."""
NORMAL_POINTS, FEATURE_POINTS = 30, 100
EDGE_LIKENESS = 0.9
DRAWS, CONFIDENCE = 100_000, 0.999
ICP_STEPS = 50


class FeaturesRegistration:
    """As base.RegistrationMethod. Raises ConfigError where Open3D is not installed."""

    def __init__(self, max_probability_wrong: float) -> None:
        self.max_probability_wrong = max_probability_wrong
        self._o3d = _open3d()

    def __call__(self, source_m: FloatArray, reference_m: FloatArray, prior: RegistrationPrior) -> Registered | NotRegistered:
        """Match features, refine, judge."""
        return judged(partial(matched, self._o3d), (source_m, reference_m), prior, self.max_probability_wrong)


def matched(o3d: ModuleType, source_m: FloatArray, reference_m: FloatArray) -> FloatArray:
    """(4, 4) similarity T_reference_source by features, then ICP."""
    o3d.utility.random.seed(0)
    methods = o3d.pipelines.registration
    source, of_source = _described(o3d, source_m)
    reference, of_reference = _described(o3d, reference_m)
    reach = MATCH_VOXELS * VOXEL_M
    with_scale = methods.TransformationEstimationPointToPoint(True)
    checks = [
        methods.CorrespondenceCheckerBasedOnEdgeLength(EDGE_LIKENESS),
        methods.CorrespondenceCheckerBasedOnDistance(reach),
    ]
    rough = methods.registration_ransac_based_on_feature_matching(
        source,
        reference,
        of_source,
        of_reference,
        True,
        reach,
        with_scale,
        3,
        checks,
        methods.RANSACConvergenceCriteria(DRAWS, CONFIDENCE),
    )
    steps = methods.ICPConvergenceCriteria(max_iteration=ICP_STEPS)
    fine = methods.registration_icp(source, reference, FINE_VOXELS * VOXEL_M, rough.transformation, with_scale, steps)
    return np.asarray(fine.transformation, dtype=np.float64)


def _described(o3d: ModuleType, points_m: FloatArray) -> tuple[Any, Any]:
    """The cloud thinned to voxels with normals that point up, and its features."""
    search = o3d.geometry.KDTreeSearchParamHybrid
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points_m)).voxel_down_sample(VOXEL_M)
    cloud.estimate_normals(search(radius=NORMAL_VOXELS * VOXEL_M, max_nn=NORMAL_POINTS))
    cloud.orient_normals_to_align_with_direction(np.array([0.0, 0.0, 1.0]))
    fpfh = o3d.pipelines.registration.compute_fpfh_feature
    return cloud, fpfh(cloud, search(radius=FEATURE_VOXELS * VOXEL_M, max_nn=FEATURE_POINTS))


def _open3d() -> ModuleType:
    try:
        import open3d
    except ImportError as missing:
        remedy = "pip install 'visloc-companion[open3d]'"
        if not isinstance(missing, ModuleNotFoundError):  # it is there, and a system library that pip does not bring is not
            remedy = "install that library (of Debian and Ubuntu: apt install libusb-1.0-0)"
        raise ConfigError(
            f"method 'features' needs Open3D, which cannot be imported ({missing})",
            where="registration.method",
            remedy=f"{remedy}, or use height-search or gicp",
        ) from missing
    assert isinstance(open3d, ModuleType)
    return open3d
