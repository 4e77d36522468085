"""Files that are wrong, broken or malicious are refused in one sentence: no traceback, no hang, no expansion."""

from __future__ import annotations

import itertools
import time
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import navsim
from navsim.convert import ConversionError, import_world, load_ros_map, load_sdf, save_ros_map, yamlfile
from navsim.convert.irsim import read_irsim
from navsim.convert.ros_map import read_ros_map
from navsim.convert.sdf import read_sdf
from navsim.convert.textfile import read_bytes
from navsim.convert.xmlfile import XmlWriter, read_xml

DATA = Path(__file__).parent / "data"
LAB = (DATA / "lab.world").read_bytes()
IRSIM = (DATA / "irsim.yaml").read_bytes()
SHELL = "<sdf version='1.9'><world name='w'>{}</world></sdf>"
MODEL = SHELL.format("<model name='m'>{}<link name='l'><collision name='c'>{}</collision></link></model>")
BOX = "<geometry><box><size>1 1 1</size></box></geometry>"

ENTITIES = [f"<!ENTITY {b} '{f'&{a};' * 10}'>" for a, b in itertools.pairwise("abcdefghi")]
LAUGHS = f"<!DOCTYPE sdf [<!ENTITY a 'ha'>{''.join(ENTITIES)}]><sdf version='1.9'><world name='&i;'/></sdf>"
CIRCLE = "".join(f"<frame name='{a}'><pose relative_to='{b}'/></frame>" for a, b in ("ab", "ba"))
CIRCLE += "<model name='m'><pose relative_to='a'>0 0 0 0 0 0</pose></model>"
CAN = "<geometry><cylinder><radius>0</radius><length>1</length></cylinder></geometry>"


def refused(path: Path, read=load_sdf) -> str:
    begin = time.process_time()
    with pytest.raises(ConversionError) as error:
        read(path)
    assert time.process_time() - begin < 20.0
    message = str(error.value)
    assert message.startswith(str(path))
    assert "\n" not in message
    return message


@pytest.mark.parametrize(
    ("content", "line", "part"),
    [
        pytest.param(LAUGHS, 1, "document type", id="billion laughs"),
        pytest.param(
            "<!DOCTYPE x SYSTEM 'file:///etc/passwd'><sdf version='1.9'/>", 1, "document type", id="external entity"
        ),
        pytest.param("<sdf version='1.9'>" + "<model name='a'>" * 5000, 1, "nested more than", id="nesting"),
        pytest.param("", 1, "not XML: no element found", id="empty"),
        pytest.param("<sdf version='1.9'>\n<world>\n</sdf>", 3, "mismatched tag", id="mismatched"),
        pytest.param("\x89PNG\r\n", 1, "not XML", id="a picture"),
        pytest.param("<?xml version='1.0' encoding='klingon'?><sdf/>", 1, "", id="unknown encoding"),
        pytest.param("<robot name='r'/>", 1, "the file is <robot>, not <sdf>", id="URDF"),
        pytest.param("<sdf version='1.3'><world/></sdf>", 1, "version '1.3'", id="too old"),
        pytest.param("<sdf version='2.0'><world/></sdf>", 1, "version '2.0'", id="too new"),
        pytest.param("<sdf><world/></sdf>", 1, "no version", id="no version"),
        pytest.param("<sdf version='1.9'><actor/></sdf>", 1, "no <world> or <model>", id="nothing"),
        pytest.param(SHELL.format(""), 0, "holds nothing that can stand in a room", id="empty world"),
        pytest.param(
            MODEL.format("\n<pose>1 2 3</pose>", BOX), 2, "<pose> must hold 6 numbers, not '1 2 3'", id="short pose"
        ),
        pytest.param(MODEL.format("<pose>1 2 3 0 0 nan</pose>", BOX), 1, "finite numbers", id="nan"),
        pytest.param(MODEL.format("<pose>1e300 2 3 0 0 0</pose>", BOX), 1, "finite numbers", id="huge"),
        pytest.param(MODEL.format("<pose>1 2 3 0 0 x</pose>", BOX), 1, "must hold numbers, not 'x'", id="a word"),
        pytest.param(
            MODEL.format("<pose relative_to='q'>0 0 0 0 0 0</pose>", BOX), 1, "no frame 'q'", id="no such frame"
        ),
        pytest.param(SHELL.format(CIRCLE), 1, "relative to itself", id="circle"),
        pytest.param(
            MODEL.format("<pose rotation_format='euler'>0 0 0 0 0 0</pose>", BOX), 1, "rotation format", id="format"
        ),
        pytest.param(
            MODEL.format("<pose rotation_format='quat_xyzw'>0 0 0 0 0 0 0</pose>", BOX), 1, "length 0", id="no turn"
        ),
        pytest.param(
            MODEL.format("", BOX.replace("1 1 1", "1 -1 1")), 1, "three lengths greater than 0", id="negative"
        ),
        pytest.param(MODEL.format("", "<geometry><box/></geometry>"), 1, "<box> lacks <size>", id="no size"),
        pytest.param(MODEL.format("", CAN), 1, "<radius> must be greater than 0", id="no radius"),
        pytest.param(
            MODEL.format("", "<geometry><polyline><point>0 0</point></polyline></geometry>"),
            1,
            "three or more",
            id="two points",
        ),
        pytest.param(MODEL.format("<static>perhaps</static>", BOX), 1, "must be true or false", id="no truth"),
        pytest.param(SHELL.format("<include/>"), 1, "<include> lacks <uri>", id="no uri"),
        pytest.param(MODEL.format("<pose>0 0 2e5 0 0 0</pose>", BOX), 0, "", id="far away"),
    ],
)
def test_what_is_wrong_with_an_sdf_file_is_told_in_one_sentence(tmp_path, content, line, part):
    path = tmp_path / "test.sdf"
    path.write_text(content)
    message = refused(path)
    assert part in message
    if line:
        assert message.startswith(f"{path}:{line}:")


def test_models_that_include_each_other_are_refused(tmp_path):
    for name, other in (("a", "b"), ("b", "a")):
        (tmp_path / name).mkdir()
        (tmp_path / name / "model.sdf").write_text(
            f"<sdf version='1.9'><model name='{name}'><include><uri>model://{other}</uri></include></model></sdf>"
        )
    path = tmp_path / "world.sdf"
    path.write_text(SHELL.format("<include><uri>model://a</uri></include>"))
    with pytest.raises(ConversionError, match="break the circle"):
        load_sdf(path)


def test_outlines_that_no_world_can_hold_are_listed(tmp_path):
    bow_tie = "<point>0 0</point><point>2 1</point><point>2 0</point><point>0 2</point>"
    line = "<point>0 0</point><point>1 1</point><point>2 2</point>"
    for points, part in ((bow_tie, "crosses or touches itself"), (line, "without an inside")):
        path = tmp_path / "test.sdf"
        path.write_text(MODEL.format("", f"<geometry><polyline>{points}<height>1</height></polyline></geometry>"))
        assert part in refused(path)


@pytest.mark.parametrize(
    ("name", "content", "part"),
    [
        ("part.zip", b"PK", "meshes of the kind .zip are not read"),
        ("part.dae", b"<!DOCTYPE a [<!ENTITY b 'c'>]><COLLADA/>", "holds a document type, which is not read"),
        ("part.stl", bytes(16 * 2**20 + 1), "is larger than 16 MiB"),
        ("part.stl", b"solid", "part.stl"),
    ],
    ids=["an archive", "entities", "too large", "broken"],
)
def test_meshes_that_ask_for_much_are_left_out(tmp_path, name, content, part):
    pytest.importorskip("trimesh")
    (tmp_path / name).write_bytes(content)
    path = tmp_path / "test.sdf"
    path.write_text(MODEL.format("", f"<geometry><mesh><uri>{name}</uri></mesh></geometry>"))
    assert part in refused(path, lambda path: load_sdf(path, approximate="convex-hull"))


def test_models_merged_without_end_are_refused(tmp_path):
    (tmp_path / "a").mkdir()
    (tmp_path / "a" / "model.sdf").write_text("<sdf version='1.9'><model name='a'><link name='l'/></model></sdf>")
    path = tmp_path / "test.sdf"
    path.write_text(SHELL.format("<include merge='true'><uri>model://a</uri></include>\n" * 101))
    assert "test.sdf:101: more than 100 models are merged into one" in refused(path)


def test_models_of_one_name_are_told_apart(tmp_path):
    body = "<link name='l'><collision name='c'><geometry><box><size>1 1 1</size></box></geometry></collision></link>"
    path = tmp_path / "test.sdf"
    models = [f"<model name='m'><static>true</static><pose>{2 * i} 0 0.5 0 0 0</pose>{body}</model>" for i in range(3)]
    path.write_text(SHELL.format("".join(models)))
    assert [obstacle.at[0] for obstacle in load_sdf(path)[0].obstacles] == [-2.0, 0.0, 2.0]


@pytest.mark.parametrize("name", ["missing.sdf", "", "a\0b"])
def test_a_file_that_is_not_there_is_told(tmp_path, name):
    path = tmp_path / name
    with pytest.raises(ConversionError, match=r"cannot be read|is a directory"):
        read_bytes(path)


def test_yaml_that_grows_without_bounds_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(yamlfile, "MOST_VALUES", 20_000)
    levels = "\n".join(f"k{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 10)}]" for i in range(1, 8))
    merges = "\n".join(f"m{i}: &m{i} {{<<: [{', '.join([f'*m{i - 1}'] * 10)}]}}" for i in range(1, 8))
    for text in (f"k0: &a0 [1]\n{levels}\nworld: {{}}", f"m0: &m0 {{a: 1}}\n{merges}\nworld: {{}}", "[" * 3000):
        path = tmp_path / "world.yaml"
        path.write_text(text)
        refused(path, import_world)


# Bytes changed at random: whatever comes of it, it is a scene or a sentence.

edits = st.lists(
    st.tuples(
        st.floats(0, 1),
        st.integers(0, 12),
        st.one_of(
            st.binary(max_size=8),
            st.sampled_from(
                [b"nan", b"-1", b"1e999", b"<", b">", b"&", b"<pose>", b"'", b"[", b"{", b"\n", b"*a", b"0 0 0 0 0 0"]
            ),
        ),
    ),
    min_size=1,
    max_size=4,
)


def mangled(content: bytes, changes: list[tuple[float, int, bytes]]) -> bytes:
    for where, dropped, added in changes:
        at = int(where * len(content))
        content = content[:at] + added + content[at + dropped :]
    return content


def survives(read, path: Path) -> None:
    message = ""
    try:
        solids = read(path).solids
    except ConversionError as error:
        message, solids = str(error), []
    assert "\n" not in message
    assert not message or str(path.parent) in message or str(DATA) in message
    for solid in solids:
        assert np.isfinite([solid.base, solid.top, *np.ravel(solid.corners())]).all()


def check_mangled_sdf(changes, directory: Path) -> None:
    path = directory / "lab.world"
    path.write_bytes(mangled(LAB, changes))
    survives(lambda file: read_sdf(file, model_paths=[DATA / "models"], approximate="convex-hull"), path)


def check_mangled_irsim(changes, directory: Path) -> None:
    path = directory / "irsim.yaml"
    path.write_bytes(mangled(IRSIM, changes))
    survives(read_irsim, path)


def check_mangled_map(changes, directory: Path) -> None:
    settings_, picture = directory / "map.yaml", directory / "map.pgm"
    if not (directory / "good").exists():
        save_ros_map(navsim.load_world("simple_eval"), settings_, resolution=0.1)
        (directory / "good").mkdir()
        for file in (settings_, picture):
            file.rename(directory / "good" / file.name)
    yaml, pixels = ((directory / "good" / file.name).read_bytes() for file in (settings_, picture))
    of_the_picture = [change for change in changes if change[1] % 2]
    head = mangled(pixels[:40], of_the_picture) + pixels[40:]
    settings_.write_bytes(mangled(yaml, [change for change in changes if not change[1] % 2]))
    picture.write_bytes(head)
    survives(read_ros_map, settings_)


FIXTURE = [HealthCheck.function_scoped_fixture]


@settings(max_examples=100, deadline=None, suppress_health_check=FIXTURE)
@given(edits)
def test_mangled_sdf_is_read_or_refused(tmp_path, changes):
    check_mangled_sdf(changes, tmp_path)


@settings(max_examples=100, deadline=None, suppress_health_check=FIXTURE)
@given(edits)
def test_mangled_irsim_is_read_or_refused(tmp_path, changes):
    check_mangled_irsim(changes, tmp_path)


@settings(max_examples=100, deadline=None, suppress_health_check=FIXTURE)
@given(edits)
def test_mangled_maps_are_read_or_refused(tmp_path, changes):
    check_mangled_map(changes, tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize("check", [check_mangled_sdf, check_mangled_irsim, check_mangled_map])
def test_a_thousand_more_mangled_files_are_read_or_refused(tmp_path, check):
    @settings(max_examples=1000, deadline=None)
    @given(edits)
    def run(changes):
        check(changes, tmp_path)

    run()


def test_a_map_that_makes_no_usable_world_is_told(tmp_path):
    (tmp_path / "map.pgm").write_bytes(b"P5\n4 4\n255\n" + bytes([254] * 16))
    (tmp_path / "map.yaml").write_text("image: map.pgm\nresolution: 0.05\norigin: [0, 0, 0]\n")
    assert "makes no world that can be used" in refused(tmp_path / "map.yaml", load_ros_map)


@given(st.text(max_size=30))
@settings(max_examples=40, deadline=None)
def test_any_text_can_be_written_as_xml_and_read_back(text):
    import tempfile

    xml = XmlWriter()
    xml.open("a", name=text)
    xml.leaf("b", text)
    xml.close()
    with tempfile.TemporaryDirectory() as directory:
        path = Path(directory) / "file.xml"
        path.write_text(xml.text, encoding="utf-8", newline="")
        root = read_xml(path)
    legal = "".join(
        c if c in "\t\n" or (c >= " " and c not in "\ufffe\uffff" and not "\ud800" <= c <= "\udfff") else "�"
        for c in text
    )
    assert root.attributes["name"] == legal
    assert root.first("b").text == legal
