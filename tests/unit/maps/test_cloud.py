import struct
import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest

from visloc_companion.errors import CloudError, MapError
from visloc_companion.maps import cloud_npz
from visloc_companion.maps.cloud import Cloud, Sampler, read_cloud, require_same_crs
from visloc_companion.maps.crs import map_crs
from visloc_companion.maps.wild import surface_mask

laspy = pytest.importorskip("laspy")


def scene(n: int = 4000, middle: tuple[float, float] = (5e5, 5.2e6)) -> np.ndarray:
    """Ground at 300 m with a house of 20 m x 20 m and 10 m, over 60 m x 60 m."""
    xy = np.random.default_rng(2).uniform(-30, 30, (n, 2))
    return np.column_stack([xy + middle, np.where((np.abs(xy) < 10).all(axis=1), 310.0, 300.0)])


def write_las(path: Path, points: np.ndarray, crs: str | None = None, classes: np.ndarray | None = None) -> Path:
    header = laspy.LasHeader(point_format=6, version="1.4")
    header.scales = np.array([0.001] * 3)
    header.offsets = np.floor(points.min(axis=0)) if len(points) else np.zeros(3)
    if crs is not None:
        from pyproj import CRS

        header.add_crs(CRS.from_user_input(crs))
    las = laspy.LasData(header)
    las.x, las.y, las.z = points.T
    las.classification = np.full(len(points), 2, np.uint8) if classes is None else classes
    las.write(path)
    return path


def write_npz(path: Path, **arrays: object) -> Path:
    np.savez_compressed(path, **arrays)
    return path


def test_npz_of_any_number_type_and_order(tmp_path: Path) -> None:
    points = np.random.default_rng(1).uniform(-40, 40, (3000, 3))
    for name, stored in (
        ("double", points),
        ("single", points.astype(np.float32)),
        ("whole", np.rint(points).astype(np.int16)),
        ("swapped", points.astype(">f4")),
        ("columns", np.asfortranarray(points)),
    ):
        cloud = read_cloud(write_npz(tmp_path / f"{name}.npz", points=stored, rgb=np.zeros((3000, 3), np.uint8)))
        np.testing.assert_array_equal(cloud.points_m, stored.astype(np.float64))
        assert cloud.crs is None and cloud.stride == 1 and cloud.note == ""


def test_npz_is_read_in_chunks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cloud_npz, "CHUNK_POINTS", 700)
    points = scene()
    np.testing.assert_array_equal(read_cloud(write_npz(tmp_path / "a.npz", points=points)).points_m, points)


def test_las_and_laz_without_noise_and_withheld_points(tmp_path: Path) -> None:
    points = scene()
    noise = points[:60] + np.array([0.0, 0.0, 12.0])
    classes = np.concatenate([np.full(len(points), 5), np.full(30, 7), np.full(30, 18)]).astype(np.uint8)
    for name in ("a.las", "a.laz", "a.LAZ"):
        path = write_las(tmp_path / name, np.concatenate([points, noise]), "EPSG:32633", classes)
        cloud = read_cloud(path)
        np.testing.assert_allclose(cloud.points_m, points, atol=0.0006)
        assert cloud.crs == map_crs("EPSG:32633")
    las = laspy.read(path)
    las.withheld = np.arange(len(las.x)) < 1000
    las.write(tmp_path / "held.laz")
    assert len(read_cloud(tmp_path / "held.laz").points_m) == len(points) - 1000


def test_feet_become_metres(tmp_path: Path) -> None:
    cloud = read_cloud(write_las(tmp_path / "c.las", scene(3000, (6e6, 2e6)), "EPSG:2227+6360"))
    np.testing.assert_allclose(cloud.points_m.mean(axis=0), scene(3000, (6e6, 2e6)).mean(axis=0) * 0.3048006, atol=0.02)


def test_a_box_is_cut_out_while_reading(tmp_path: Path) -> None:
    points = scene()
    inside = (points[:, 0] >= 5e5 + 5) & (points[:, 0] <= 5e5 + 20) & (points[:, 1] >= 5.2e6 - 10) & (points[:, 1] <= 5.2e6)
    for path in (write_las(tmp_path / "a.laz", points), write_npz(tmp_path / "a.npz", points=points)):
        cloud = read_cloud(path, box_m=(5e5 + 5, 5.2e6 - 10, 5e5 + 20, 5.2e6))
        np.testing.assert_allclose(cloud.points_m, points[inside], atol=0.0006)
        with pytest.raises(CloudError, match=rf"{path.name}: holds no point within.*remedy"):
            read_cloud(path, box_m=(0.0, 0.0, 10.0, 10.0))


def test_too_many_points_are_thinned_evenly_and_said(tmp_path: Path) -> None:
    points = scene(5000)
    cloud = read_cloud(write_npz(tmp_path / "a.npz", points=points), max_points=1500)
    np.testing.assert_array_equal(cloud.points_m, points[::4])
    assert cloud.stride == 4 and "every 4th point" in cloud.note and "a.npz" in cloud.note


@pytest.mark.parametrize("sizes", [(1000,), (1, 999), (333, 333, 334), (7,) * 142 + (6,), (0, 1000, 0)])
def test_what_is_kept_depends_not_on_the_chunks(sizes: tuple[int, ...]) -> None:
    points = np.arange(3000.0).reshape(1000, 3)
    sampler, start = Sampler(1000, 64), 0
    for size in sizes:
        sampler.add(points[start : start + size])
        start += size
    np.testing.assert_array_equal(sampler.points, points[:: sampler.stride])
    assert sampler.stride == 16


def test_points_alone_in_the_air_and_below_the_ground_are_left_out(tmp_path: Path) -> None:
    points = scene()
    wild = np.array([[5e5, 5.2e6, 360.0], [5e5 + 9, 5.2e6, 220.0], [5e5 + 9.5, 5.2e6, 220.5], [7e5, 5.4e6, 300.0]])
    cloud = read_cloud(write_npz(tmp_path / "a.npz", points=np.concatenate([wild, points])))
    np.testing.assert_array_equal(cloud.points_m, points)
    assert cloud.n_wild == 4


def test_thin_clouds_steep_ground_and_masts_stay() -> None:
    rng = np.random.default_rng(3)
    xy = rng.uniform(0, 300, (300, 2))
    thin = np.column_stack([xy, 40 * np.sin(xy[:, 0] / 60)])
    cliff = np.column_stack([rng.uniform(0, 60, (4000, 2)), np.repeat([0.0, 150.0], 2000)])
    mast = np.column_stack([np.full(30, 10.0), np.full(30, 10.0), np.linspace(0, 60, 30)])
    for points in (thin, cliff, np.concatenate([cliff[:2000], mast]), rng.uniform(0, 1e5, (40, 3)), np.zeros((1, 3))):
        assert surface_mask(points).all()


def damaged_npz(path: Path, name: str) -> Path:
    whole = write_npz(path.with_name("whole.npz"), points=np.random.default_rng(1).random((5000, 3))).read_bytes()
    content = {
        "cut": whole[: len(whole) // 2],
        "flipped": whole[:2000] + b"\x00" * 40 + whole[2040:],
        "text": b"east,north\n1,2\n",
    }
    path.write_bytes(content[name])
    return path


@pytest.mark.parametrize("kind", ["cut", "flipped", "text"])
def test_damaged_npz_is_named(tmp_path: Path, kind: str) -> None:
    with pytest.raises(CloudError, match=rf"{kind}\.npz.*remedy"):
        read_cloud(damaged_npz(tmp_path / f"{kind}.npz", kind))


@pytest.mark.parametrize(
    ("arrays", "what"),
    [
        ({"xyz": np.zeros((5, 3))}, "has no array 'points', it has xyz"),
        ({"points": np.zeros((0, 3))}, "points: holds no point"),
        ({"points": np.zeros((5, 4))}, r"points: has the shape \(5, 4\), not \(N, 3\)"),
        ({"points": np.zeros(15)}, r"points: has the shape \(15,\)"),
        ({"points": np.array([[1, 2, 3]], dtype=object)}, "points: holds pickled objects, which are never loaded"),
        ({"points": np.array([["a", "b", "c"]])}, "points: holds <U1, not numbers"),
        ({"points": np.array([[0.0, 0.0, np.nan], [0.0, 0.0, np.inf]])}, "points: 2 values are not finite"),
        ({"points": np.array([[0.0, 0.0, 1e30]])}, r"points: coordinates of up to 1e\+30 m are no place"),
    ],
)
def test_what_is_no_cloud_is_named(tmp_path: Path, arrays: dict[str, np.ndarray], what: str) -> None:
    with pytest.raises(CloudError, match=rf"bad\.npz.*{what}.*remedy"):
        read_cloud(write_npz(tmp_path / "bad.npz", **arrays))


@pytest.mark.parametrize("header", [b"no header at all", b"\x93NUMPY\x01\x00v\x00" + b"{" * 118, b"\x93NUMPY\x09\x00v\x00"])
def test_arrays_with_a_broken_header(tmp_path: Path, header: bytes) -> None:
    with zipfile.ZipFile(tmp_path / "bad.npz", "w") as archive:
        archive.writestr("points.npy", header)
    with pytest.raises(CloudError, match=r"bad\.npz: points.*remedy"):
        read_cloud(tmp_path / "bad.npz")


def test_an_array_shorter_than_its_header_says(tmp_path: Path) -> None:
    write_npz(tmp_path / "a.npz", points=np.zeros((100, 3)))
    with zipfile.ZipFile(tmp_path / "a.npz") as archive:
        raw = archive.read("points.npy")
    for name, content in (("short", raw[:-8]), ("long", raw.replace(b"(100, 3)", b"(999999999, 3)", 1))):
        with zipfile.ZipFile(tmp_path / f"{name}.npz", "w") as archive:
            archive.writestr("points.npy", content)
        with pytest.raises(CloudError, match=rf"{name}\.npz.*remedy"):
            read_cloud(tmp_path / f"{name}.npz")


def test_columns_that_memory_does_not_hold_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cloud_npz, "LARGEST_BY_COLUMNS", 99)
    with pytest.raises(CloudError, match=r"column by column.*ascontiguousarray"):
        read_cloud(write_npz(tmp_path / "a.npz", points=np.asfortranarray(np.random.default_rng(1).random((100, 3)))))


def test_damaged_las_is_named(tmp_path: Path) -> None:
    for suffix in ("las", "laz"):
        whole = write_las(tmp_path / f"whole.{suffix}", scene()).read_bytes()
        (tmp_path / f"cut.{suffix}").write_bytes(whole[: len(whole) * 2 // 3])
        (tmp_path / f"head.{suffix}").write_bytes(whole[:100])
        (tmp_path / f"text.{suffix}").write_bytes(b"points" * 500)
        for name in ("cut", "head", "text", "absent"):
            with pytest.raises(CloudError, match=rf"{name}\.{suffix}.*remedy"):
                read_cloud(tmp_path / f"{name}.{suffix}")


def test_bounds_that_are_none(tmp_path: Path) -> None:
    raw = bytearray(write_las(tmp_path / "a.las", scene()).read_bytes())
    raw[179:187] = np.array([np.nan]).tobytes()  # LAS 1.4, table 3: maximum x
    (tmp_path / "a.las").write_bytes(raw)
    with pytest.raises(CloudError, match=r"a\.las: header: bounds.*remedy"):
        read_cloud(tmp_path / "a.las")


@pytest.mark.parametrize(("at", "value"), [(131, 0.0), (147, 0.0), (139, np.nan), (155, np.inf)])
def test_scales_and_offsets_that_give_no_coordinates(tmp_path: Path, at: int, value: float) -> None:
    raw = bytearray(write_las(tmp_path / "a.las", scene()).read_bytes())
    struct.pack_into("<d", raw, at, value)  # LAS 1.4, table 3: scale factors of x, z, y; offset of x
    (tmp_path / "a.las").write_bytes(raw)
    with pytest.raises(CloudError, match=r"a\.las: header: scale factors .* give no coordinates; remedy"):
        read_cloud(tmp_path / "a.las")


@pytest.mark.parametrize("at", [103, 246])
def test_a_header_that_states_billions_of_records_is_refused_at_once(tmp_path: Path, at: int) -> None:
    raw = bytearray(write_las(tmp_path / "a.laz", scene()).read_bytes())
    raw[at] = 200  # LAS 1.4, table 3: number of variable length records, and of extended ones
    (tmp_path / "a.laz").write_bytes(raw)
    with pytest.raises(CloudError, match=r"a\.laz: header: states .* records, for which it has no room; remedy"):
        read_cloud(tmp_path / "a.laz")


def test_las_without_a_surface_is_named(tmp_path: Path) -> None:
    write_las(tmp_path / "empty.laz", np.zeros((0, 3)))
    write_las(tmp_path / "noise.las", scene(50), None, np.full(50, 7, np.uint8))
    write_las(tmp_path / "degrees.las", np.array([[15.0, 47.0, 300.0], [15.1, 47.1, 300.0]]), "EPSG:4326")
    for name, what in (("empty.laz", "no point"), ("noise.las", "no point that is a surface"), ("degrees.las", "in degrees")):
        with pytest.raises(CloudError, match=rf"{name}.*{what}.*remedy"):
            read_cloud(tmp_path / name)


def test_formats_that_are_none(tmp_path: Path) -> None:
    for name in ("cloud.ply", "cloud"):
        (tmp_path / name).write_bytes(b"ply")
        with pytest.raises(CloudError, match=r"no format of clouds.*\.npz, \.laz or \.las"):
            read_cloud(tmp_path / name)
    with pytest.raises(CloudError, match=r"absent\.npz: there is no such file"):
        read_cloud(tmp_path / "absent.npz")


def test_a_missing_extra_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = write_las(tmp_path / "a.laz", scene())
    monkeypatch.setitem(sys.modules, "laspy", None)
    with pytest.raises(MapError, match=r"needs laspy.*visloc-companion\[prep\]"):
        read_cloud(path)


def test_clouds_of_different_crs_are_refused() -> None:
    def cloud(crs: str | None) -> Cloud:
        return Cloud(f"{crs}.laz", np.zeros((1, 3)), map_crs(crs) if crs else None, 1, 0)

    require_same_crs(cloud("EPSG:32633"), cloud("EPSG:32633"))
    require_same_crs(cloud(None), cloud("EPSG:32633"))
    with pytest.raises(CloudError, match=r"EPSG:32632\.laz: is in WGS 84 / UTM zone 32N, the reference in .*33N.*remedy"):
        require_same_crs(cloud("EPSG:32632"), cloud("EPSG:32633"))


@pytest.mark.parametrize(
    ("older", "newer", "one_grid"),
    [
        ("EPSG:26911", "EPSG:6340", True),  # NAD83 and NAD83(2011), both UTM 11N
        ("EPSG:26911", "EPSG:2955", True),  # NAD83(CSRS)
        ("EPSG:28356", "EPSG:7856", True),  # GDA94 and GDA2020
        ("EPSG:26711", "EPSG:26911", False),  # NAD27: 200 m to the south
        ("EPSG:23032", "EPSG:25832", False),  # ED50
        ("EPSG:2277", "EPSG:32139", False),  # one projection, in feet and in metres, with other false eastings
    ],
)
def test_epochs_in_two_realisations_of_a_datum_are_one_grid(older: str, newer: str, one_grid: bool) -> None:
    source, reference = (Cloud(f"{crs}.laz", np.zeros((1, 3)), map_crs(crs), 1, 0) for crs in (newer, older))
    if one_grid:
        require_same_crs(source, reference)
    else:
        with pytest.raises(CloudError, match="the reference in"):
            require_same_crs(source, reference)


@pytest.mark.shared
def test_a_real_cloud_survives_the_loss_of_its_noise_class(shared_data: Path, tmp_path: Path) -> None:
    """Nine wild points of class 7, from -47 m to +84 m, in a plantation of at most 35 m."""
    path = shared_data / "clouds" / "eucalyptus_farm.laz"
    heights = read_cloud(path).points_m[:, 2]
    assert heights.min() > -3 and heights.max() < 40
    las = laspy.read(path)
    every = np.column_stack([las.x, las.y, las.z])
    noise = np.asarray(las.classification) == 7
    blind = read_cloud(write_npz(tmp_path / "a.npz", points=np.concatenate([every[~noise][::12], every[noise]])))
    assert blind.points_m[:, 2].min() > -3 and blind.points_m[:, 2].max() < 40


@pytest.mark.parametrize(("n_chunks", "what"), [(0xFFFFFFF0, "states 4294967280 chunks"), (None, "outside of the file")])
def test_a_laz_file_that_states_impossible_chunks_is_named(tmp_path: Path, n_chunks: int | None, what: str) -> None:
    """The decoder would take the memory for them, and abort the process."""
    las = laspy.LasData(laspy.LasHeader(point_format=1, version="1.2"))
    las.x = las.y = las.z = np.arange(100.0)
    path = tmp_path / "bad.laz"
    las.write(path)
    raw = bytearray(path.read_bytes())
    (to_points,) = struct.unpack_from("<I", raw, 96)
    (table,) = struct.unpack_from("<q", raw, to_points)
    if n_chunks is None:
        struct.pack_into("<q", raw, to_points, len(raw) + 1)
    else:
        struct.pack_into("<I", raw, table + 4, n_chunks)
    path.write_bytes(raw)
    with pytest.raises(CloudError, match=rf"bad\.laz.*{what}.*remedy"):
        read_cloud(path)
