"""Facts about the printed parts as solids, and about the files that are made of them. build123d comes with --full."""

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
from measures import MOUNTS, load

pytestmark = pytest.mark.full
pytest.importorskip("build123d", reason="tools/test.py --full installs it")

import ezdxf  # noqa: E402
import files  # noqa: E402
from build123d import Box, GeomType, Pos, Rot  # noqa: E402
from solids import PARTS, assembly, motor, plate, sleeve  # noqa: E402

EVERY_MOUNT = pytest.mark.parametrize("name", MOUNTS)
STL = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("unused", "<u2")])


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """The folder with the files of every mount."""
    folder = tmp_path_factory.mktemp("mechanics")
    assert files.main(["--to", str(folder)]) == 0
    return folder


def mesh(path):
    """The corners of an STL's triangles."""
    return np.frombuffer(path.read_bytes()[84:], STL)["corners"].astype(float)


def common(a, b):
    """The volume that two solids share."""
    both = a & b
    return sum(solid.volume for solid in both.solids()) if both else 0.0


@EVERY_MOUNT
@pytest.mark.parametrize("part", PARTS)
def test_a_part_is_one_closed_solid_that_lies_on_the_printers_bed(name, part, made):
    solid = PARTS[part](load(MOUNTS[name]))
    assert solid.is_valid and len(solid.solids()) == 1
    assert abs(solid.bounding_box().min.Z) < 1e-6
    triangles = mesh(made / name / f"{part}.stl")
    number = np.unique(triangles.round(4).reshape(-1, 3), axis=0, return_inverse=True)[1]
    edges = [(a, b) for t in number.reshape(-1, 3) for a, b in ((t[0], t[1]), (t[1], t[2]), (t[2], t[0])) if a != b]
    assert len(edges) == len(set(edges)) and {(b, a) for a, b in edges} == set(edges)  # each edge once in either sense
    a, b, c = (triangles[:, i] for i in range(3))
    assert np.einsum("ij,ij->", a, np.cross(b, c)) / 6 == pytest.approx(solid.volume, rel=0.01)


@EVERY_MOUNT
def test_the_holes_of_the_plate_are_where_the_adjusters_and_the_motors_screws_are(name):
    m = load(MOUNTS[name])
    round_faces = [f for f in plate(m).faces() if f.geom_type == GeomType.CYLINDER]
    axes = [(*tuple(f.axis_of_rotation.position)[:2], 2 * f.radius) for f in round_faces]
    shafts = [axis for axis in axes if axis[2] == pytest.approx(m.shaft_hole)]
    (x1, y1, _), (x2, y2, _) = sorted(shafts)
    assert (x2 - x1, y1 - y2) == pytest.approx((m.adjusters_x, m.adjusters_y))
    for x, y, _ in shafts:
        near = [a for a in axes if a[2] < 2 and math.dist(a[:2], (x, y)) < 6]
        assert len(near) == 2 and math.dist(near[0][:2], near[1][:2]) == pytest.approx(9)


@EVERY_MOUNT
def test_the_dxf_has_the_plates_circles_and_its_outline_in_mm(name, made):
    m = load(MOUNTS[name])
    drawing = ezdxf.readfile(made / name / "plate.dxf")
    assert drawing.units == ezdxf.units.MM
    entities = list(drawing.modelspace())
    circles = sorted((*e.dxf.center.vec2, 2 * e.dxf.radius) for e in entities if e.dxftype() == "CIRCLE")
    wanted = sorted(hole for group in m.plate_holes().values() for hole in group)
    assert len(circles) == len(wanted) == 13
    assert np.allclose(circles, wanted, atol=1e-4)
    ends = [point for e in entities if e.dxftype() == "LINE" for point in (e.dxf.start, e.dxf.end)]
    w, h = m.plate_size
    assert [max(p.x for p in ends), max(p.y for p in ends)] == pytest.approx([w / 2, h / 2])
    assert [min(p.x for p in ends), min(p.y for p in ends)] == pytest.approx([-w / 2, -h / 2])


@EVERY_MOUNT
@pytest.mark.parametrize("part", PARTS)
def test_a_wall_is_as_thick_as_the_arithmetic_says(name, part, made):
    # from the middle of each larger triangle, straight into the part until it comes out again
    m, triangles = load(MOUNTS[name]), mesh(made / name / f"{part}.stl")
    a, ab, ac = triangles[:, 0], triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    cross = np.cross(ab, ac)
    area = np.linalg.norm(cross, axis=1) / 2
    normals = cross / (2 * area[:, None] + 1e-12)
    thinnest = math.inf
    for i in np.flatnonzero(area > 0.3):
        start = triangles[i].mean(0) - 1e-4 * normals[i]
        p = np.cross(-normals[i], ac)
        det = np.einsum("ij,ij->i", ab, p)
        det[np.abs(det) < 1e-9] = math.inf  # along the ray
        q = np.cross(start - a, ab)
        u, v, t = np.einsum("ij,ij->i", start - a, p) / det, q @ -normals[i] / det, np.einsum("ij,ij->i", ac, q) / det
        hit = (u >= 0) & (v >= 0) & (u + v <= 1) & (t > 0)
        thinnest = min(thinnest, t[hit].min())
    assert thinnest >= m.least_wall - 0.03
    assert thinnest >= m.walls()[part] - 0.05


@EVERY_MOUNT
def test_a_motors_body_fits_where_it_belongs(name):
    m = load(MOUNTS[name])
    (x, y), _ = m.motors
    body = Pos(x, y, m.plate_thickness) * Rot(180, 0, 0) * motor(m)
    assert common(body, plate(m)) == 0
    box = body.bounding_box()
    assert pytest.approx((12, 10)) == (box.size.X, box.size.Y)  # Pololu's cross section
    for x_hole, y_hole, diameter in m.plate_holes()["motor screw"][:2]:  # in the gearbox, not beside it
        assert abs(x_hole - x) + diameter / 2 < 6 and y_hole == pytest.approx(y)
    wide = replace(m, shaft_diameter=5.0)
    assert common(Pos(x, y, m.plate_thickness) * Rot(180, 0, 0) * motor(wide), plate(m)) > 0


@EVERY_MOUNT
@pytest.mark.parametrize("slide", [-1, 0, 1])
def test_the_sleeve_slides_over_its_play_and_meets_neither_shaft_plate_nor_screws(name, slide):
    m = load(MOUNTS[name])
    shaft = motor(m) & Pos(0, 0, 50) * Box(20, 20, 100)
    gap = m.axial_play * (1 + slide)
    at = Pos(0, 0, m.plate_thickness + gap) * sleeve(m)
    assert common(at, shaft) < 1e-6
    assert common(at, Pos(0, 0, m.plate_thickness / 2) * Box(20, 20, m.plate_thickness)) < 1e-6
    for x in (-4.5, 4.5):
        head = Pos(x, 0, m.plate_thickness + m.motor_screw / 2) * Box(m.motor_screw_head, 3, m.motor_screw)
        assert common(at, head) == 0
    turned = Rot(0, 0, max(m.loose_deg) / 2 + 3) * shaft
    assert common(at, turned) > 0  # the flat holds


@EVERY_MOUNT
def test_nothing_of_the_built_mount_stands_in_anything_else(name):
    built = assembly(load(MOUNTS[name]), files.SWITCHED)
    boxes = [shape.bounding_box() for _, shape in built]
    meet = {
        tuple(sorted((built[i][0], built[j][0])))
        for i, j in itertools.combinations(range(len(built)), 2)
        if all(
            getattr(boxes[i].min, c) < getattr(boxes[j].max, c) and getattr(boxes[j].min, c) < getattr(boxes[i].max, c)
            for c in "XYZ"
        )
        and common(built[i][1], built[j][1]) > 1e-3
    }
    assert meet == {("spring", "spring_pin")}  # the pin goes through the spring's end


@EVERY_MOUNT
def test_each_mount_has_its_files(name, made):
    kinds = {f"{part}.{kind}" for part in PARTS for kind in ("step", "stl")}
    there = {path.name for path in (made / name).iterdir()}
    assert there == kinds | {"plate.dxf", "drawings.pdf", "built.png", "bill.csv"}
    assert (made / name / "plate.step").read_text().startswith("ISO-10303-21")
    pdf = (made / name / "drawings.pdf").read_bytes()
    assert pdf.startswith(b"%PDF") and pdf.count(b"/Type /Page\n") + pdf.count(b"/Type /Page ") == len(PARTS) + 1


def test_a_file_with_a_fault_is_told_in_one_line_and_makes_nothing(tmp_path, capsys):
    (tmp_path / "mine.toml").write_text("adjusters_x = 40")
    assert files.main([str(tmp_path / "mine.toml"), "--to", str(tmp_path / "out")]) == 1
    told = capsys.readouterr().out
    assert told.count("\n") == 1 and "adjusters_y is missing" in told
    assert not (tmp_path / "out").exists()
