"""The server behind the page: what it answers, whom it refuses, and how it treats the file."""

from __future__ import annotations

import http.client
import json
import os
import re
import signal
import socket
import stat
import subprocess
import sys
import threading
import urllib.request

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import navsim
from navsim.editor import server as server_module
from navsim.editor.file import LARGEST_TEXT, ChangedOnDiskError, EditedFile
from navsim.editor.reading import read_world
from navsim.editor.server import EditorServer, edit
from navsim.errors import WorldError

ROOM = (
    "format: 1  # the first\nsize: [6.0, 6.0]\nobstacles:\n  - box: {at: [1.0, 0.0], size: [1.0, 1.0], height: 1.0}\n"
    "starts:\n  - [-2.0, 0.0]\ngoals:\n  - [2.5, 0.0]\n"
)


@pytest.fixture
def room(tmp_path):
    path = tmp_path / "room.yaml"
    path.write_text(ROOM)
    return path


@pytest.fixture
def server(room):
    with EditorServer(EditedFile(room)) as running:
        thread = threading.Thread(target=running.serve_forever, kwargs={"poll_interval": 0.02}, daemon=True)
        thread.start()
        yield running
        running.shutdown()
        thread.join()


def ask(server, method, path, body=None, headers=None, token=None):
    """Status, headers and body of an answer."""
    connection = http.client.HTTPConnection("127.0.0.1", server.server_address[1], timeout=20)
    sent = {"Content-Type": "application/json", **(headers or {})} if method == "POST" else headers or {}
    content = json.dumps(body).encode() if isinstance(body, (dict, list)) else body
    connection.request(method, f"/{server.token if token is None else token}/{path}", content, sent)
    response = connection.getresponse()
    answer = response.status, response.headers, response.read()
    connection.close()
    return answer


def told(server, path, body, **options):
    status, _, content = ask(server, "POST", path, body, **options)
    return status, json.loads(content)


def test_the_page_and_all_that_it_asks_for_are_served(server):
    status, headers, page = ask(server, "GET", "")
    assert (status, headers["Content-Type"]) == (200, "text/html; charset=utf-8")
    assert "default-src 'none'" in headers["Content-Security-Policy"]
    for name in ("editor.css", "main.js", "plan.js", "icon.svg"):
        assert ask(server, "GET", name)[0] == 200
    assert b"//" not in page.replace(b"http://www.w3.org", b"").split(b"<body>")[0]  # nothing from elsewhere
    assert ask(server, "GET", "../server.py")[0] == ask(server, "GET", "%2e%2e/file.py")[0] == 404
    assert ask(server, "GET", "nothing.js")[0] == 404


def test_a_text_is_read_and_drawn_with_the_places_of_its_entries(server):
    status, answer = told(server, "api/read", {"text": ROOM})
    assert status == 200
    assert answer["problems"] == []
    (box,) = answer["scene"]["obstacles"]
    assert (box["kind"], box["at"], box["name"], box["named"]) == ("box", [1.0, 0.0], "box 1", False)
    assert ROOM[slice(*box["span"])] == "box: {at: [1.0, 0.0], size: [1.0, 1.0], height: 1.0}"
    assert answer["scene"]["starts"][0]["yaw_deg"] is None


def test_problems_come_with_their_place_and_their_entry_and_a_drawable_world_is_drawn_all_the_same(server):
    _, inside = told(server, "api/read", {"text": ROOM.replace("[2.5, 0.0]", "[1.0, 0.0]")})
    (problem,) = inside["problems"]
    assert (problem["line"], problem["column"], problem["where"]) == (8, 5, ["goals", 0])
    assert "is inside 'box 1'" in problem["text"]
    assert inside["scene"]["goals"][0]["at"] == [1.0, 0.0]
    _, broken = told(server, "api/read", {"text": ROOM.replace("height: 1.0", "height: -1")})
    assert broken["scene"] is None
    assert broken["problems"][0]["where"] == ["obstacles", 0]
    _, no_yaml = told(server, "api/read", {"text": "format: [1\n"})
    assert no_yaml["scene"] is None
    assert "not YAML" in no_yaml["problems"][0]["text"]


def test_an_edit_gives_the_new_text_and_what_it_says(server):
    edits = [{"op": "set", "where": ["obstacles", 0], "values": {"at": [1.5, 0.0]}}]
    status, answer = told(server, "api/edit", {"text": ROOM, "edits": edits})
    assert status == 200
    assert answer["text"] == ROOM.replace("[1.0, 0.0]", "[1.5, 0.0]")
    assert answer["scene"]["obstacles"][0]["at"] == [1.5, 0.0]
    status, answer = told(server, "api/edit", {"text": "format: [1", "edits": edits})
    assert status == 422
    assert "cannot be read" in answer["error"]


def test_the_depth_image_is_the_ray_casters(server):
    _, answer = told(server, "api/read", {"text": ROOM})
    pose = [-2.0, 0.3, 0.4]
    question = {"world": answer["world"], "pose": pose, "width": 40, "height": 30}
    status, headers, content = ask(server, "POST", "api/depth", question)
    assert (status, headers["Content-Type"]) == (200, "application/octet-stream")
    image = np.frombuffer(content, "<u2").reshape(30, 40) / 1000
    world = read_world(ROOM).world
    expected = navsim.render_depth(world, np.array([pose]), navsim.DepthCamera(width=40, height=30))[0]
    np.testing.assert_allclose(image, expected, atol=6e-4)


def test_paths_are_those_of_the_planner_and_pairs_without_one_are_told(server):
    _, answer = told(server, "api/read", {"text": ROOM})
    (pair,) = told(server, "api/paths", {"world": answer["world"]})[1]["pairs"]
    world = read_world(ROOM).world
    assert pair["length"] == pytest.approx(navsim.planner.shortest_path_length(world, (-2, 0), (2.5, 0)), abs=1e-3)
    wall = "  - box: {at: [0, 0], size: [0.1, 6], height: 1}\n"
    _, answer = told(server, "api/read", {"text": ROOM.replace("starts:", wall + "starts:")})
    (pair,) = told(server, "api/paths", {"world": answer["world"]})[1]["pairs"]
    assert pair == {"start": 0, "goal": 0, "points": None, "length": None}


def test_what_is_odd_is_told_with_its_place(server):
    text = ROOM.replace("at: [1.0, 0.0], size", "at: [1.0, 2.8], size")
    _, answer = told(server, "api/read", {"text": text})
    assert answer["problems"] == []
    (problem, *_) = told(server, "api/oddities", {"world": answer["world"]})[1]["problems"]
    assert (problem["severity"], problem["where"], problem["line"]) == ("warning", ["obstacles", 0], 4)
    assert "beyond the room" in problem["text"]


def test_strangers_are_refused(server):
    port = server.server_address[1]
    assert ask(server, "GET", "api/file", token="guess")[0] == 404
    assert ask(server, "GET", "api/file", token="")[0] == 404
    assert ask(server, "GET", "api/file", headers={"Host": "evil.example"})[0] == 403
    assert ask(server, "GET", "api/file", headers={"Host": f"evil.example:{port}"})[0] == 403
    assert ask(server, "GET", "api/file", headers={"Host": f"localhost:{port}"})[0] == 200
    assert ask(server, "GET", "api/file", headers={"Origin": "http://evil.example"})[0] == 403
    assert ask(server, "GET", "api/file", headers={"Origin": "null"})[0] == 403
    assert ask(server, "POST", "api/read", {"text": ROOM}, {"Origin": f"http://127.0.0.1:{port}"})[0] == 200
    form = {"Content-Type": "application/x-www-form-urlencoded"}
    assert ask(server, "POST", "api/save", b"text=1", form)[0] == 415
    assert server.server_address[0] == "127.0.0.1"
    for method in ("PUT", "DELETE", "OPTIONS"):
        assert ask(server, method, "api/file")[0] == 501


@pytest.mark.parametrize(
    ("path", "body", "status"),
    [
        ("api/read", b"not json", 400),
        ("api/read", b"[]", 400),
        ("api/read", b'{"text": 1}', 400),
        ("api/read", b'{"text": "\\ud800"}', 400),
        ("api/read", b"[" * 100_000, 400),
        ("api/edit", {"text": ROOM, "edits": 1}, 400),
        ("api/edit", {"text": ROOM, "edits": [1]}, 422),
        ("api/edit", {"text": ROOM, "edits": [{"op": "remove", "where": ["goals", 9]}]}, 422),
        ("api/depth", {"world": "unknown", "pose": [0, 0, 0], "width": 4, "height": 4}, 410),
        ("api/paths", {"world": None}, 410),
        ("api/save", {"text": ROOM}, 400),
        ("api/nothing", {}, 404),
    ],
)
def test_questions_that_make_no_sense_get_a_sentence(server, path, body, status):
    answered, answer = told(server, path, body)
    assert answered == status
    assert list(answer) == ["error"]
    assert answer["error"]
    assert "\n" not in answer["error"]


@pytest.mark.parametrize(
    "change",
    [{"pose": [0, 0]}, {"pose": [0, 0, 1e400]}, {"pose": "x"}, {"width": 0}, {"width": 99999}, {"height": True}],
)
def test_depth_images_of_no_size_or_from_nowhere_are_refused(server, change):
    _, answer = told(server, "api/read", {"text": ROOM})
    question = {"world": answer["world"], "pose": [0, 0, 0], "width": 640, "height": 480, **change}
    body = json.dumps(question).encode()  # writes Infinity, which is not JSON
    assert ask(server, "POST", "api/depth", body)[0] == 400


def test_a_question_that_is_too_long_is_refused_unread(server):
    with socket.create_connection(server.server_address) as client:
        head = f"POST /{server.token}/api/read HTTP/1.1\r\nHost: 127.0.0.1:{server.server_address[1]}\r\n"
        client.sendall(f"{head}Content-Type: application/json\r\nContent-Length: 999999999\r\n\r\n".encode())
        assert client.recv(100).startswith(b"HTTP/1.1 413 ")
    assert told(server, "api/read", {"text": "#" * (LARGEST_TEXT + 1)})[0] == 413


@settings(max_examples=25, deadline=None)
@given(st.text(max_size=60) | st.text(alphabet="[]{}&*a:- \n1#<", max_size=80))
def test_any_text_gets_an_answer(text):
    reading = read_world(text)
    assert reading.findings
    assert all(finding.line >= 1 and finding.column >= 1 and finding.text for finding in reading.findings)


def test_a_flood_of_aliases_is_told_not_drowned_in():
    text = "a0: &a0 [1, 1]\n" + "".join(f"a{i}: &a{i} [{', '.join([f'*a{i - 1} '] * 9)}]\n" for i in range(1, 12))
    reading = read_world(text)
    assert reading.world is None
    assert "holds more than" in reading.findings[0].text


def test_saving_writes_the_text_and_answers_with_the_new_stamp(server, room):
    begun = json.loads(ask(server, "GET", "api/file")[2])
    assert begun["text"] == ROOM
    status, answer = told(server, "api/save", {"text": ROOM + "# é\n", "stamp": begun["stamp"]})
    assert status == 200
    assert room.read_text(encoding="utf-8") == ROOM + "# é\n"
    assert told(server, "api/save", {"text": ROOM, "stamp": answer["stamp"]})[0] == 200


def test_a_file_that_has_changed_meanwhile_is_not_overwritten_unseen(server, room):
    stamp = json.loads(ask(server, "GET", "api/file")[2])["stamp"]
    room.write_text("format: 1\nsize: [9, 9]\n")
    status, answer = told(server, "api/save", {"text": ROOM, "stamp": stamp})
    assert status == 409
    assert "changed by another program" in answer["error"]
    assert answer["disk"]["text"] == room.read_text() == "format: 1\nsize: [9, 9]\n"
    assert told(server, "api/save", {"text": ROOM, "stamp": answer["disk"]["stamp"]})[0] == 200
    assert room.read_text() == ROOM
    stamp = json.loads(ask(server, "GET", "api/file")[2])["stamp"]
    room.unlink()
    status, answer = told(server, "api/save", {"text": ROOM, "stamp": stamp})
    assert status == 409
    assert "deleted" in answer["error"]
    assert not room.exists()


def test_a_save_keeps_permissions_and_links_and_leaves_nothing_behind(room, tmp_path):
    room.chmod(0o640)
    (tmp_path / "link.yaml").symlink_to(room)
    file = EditedFile(tmp_path / "link.yaml")
    file.save(ROOM + "#\n", file.state().stamp)
    assert (tmp_path / "link.yaml").is_symlink()
    assert room.read_text() == ROOM + "#\n"
    assert stat.S_IMODE(room.stat().st_mode) == 0o640
    assert sorted(os.listdir(tmp_path)) == ["link.yaml", "room.yaml"]


def test_a_save_that_fails_half_way_leaves_the_old_file(room, monkeypatch):
    file = EditedFile(room)
    stamp = file.state().stamp

    def refuse(handle):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", refuse)
    with pytest.raises(OSError, match="No space"):
        file.save("format: 1\n", stamp)
    assert room.read_text() == ROOM
    assert os.listdir(room.parent) == ["room.yaml"]


def test_what_the_system_refuses_is_told_in_a_sentence(server, room, monkeypatch):
    stamp = json.loads(ask(server, "GET", "api/file")[2])["stamp"]

    def refuse(source, target):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(os, "replace", refuse)
    status, answer = told(server, "api/save", {"text": "", "stamp": stamp})
    assert (status, answer["error"]) == (403, f"{room} cannot be written (Permission denied); nothing has been changed")


@pytest.mark.parametrize(
    ("before", "edited", "after"),
    [
        ("a\r\nb\r\n", "a\nc\nb\n", "a\r\nc\r\nb\r\n"),
        ("\ufeffa\nb", "a\nc", "\ufeffa\nc"),
        ("a\r\nb\nc\r\nd\r\n", "a\nb\nx\nc\nd\n", "a\r\nb\nx\r\nc\r\nd\r\n"),
        ("a\rb\r", "a\nx\nb\n", "a\rx\rb\r"),
        ("", "a\nb\n", "a\nb\n"),
    ],
)
def test_line_breaks_and_byte_order_marks_stay(tmp_path, before, edited, after):
    path = tmp_path / "room.yaml"
    path.write_bytes(before.encode())
    file = EditedFile(path)
    assert "\r" not in file.state().text
    assert not file.state().text.startswith("\ufeff")
    file.save(edited, file.state().stamp)
    assert path.read_bytes() == after.encode()
    path.write_bytes(before.encode())
    file.save(file.state().text, file.state().stamp)
    assert path.read_bytes() == before.encode()


def test_a_new_file_begins_with_a_world_that_keeps_the_rules_and_is_written_when_saved(tmp_path):
    file = EditedFile(tmp_path / "hall.yaml")
    state = file.state()
    assert state.stamp == ""
    assert read_world(state.text).findings == ()
    assert read_world(state.text).world.name == "hall"
    assert not file.path.exists()
    file.save(state.text, "")
    assert navsim.load_world(file.path).name == "hall"
    assert stat.S_IMODE(file.path.stat().st_mode) & 0o600 == 0o600
    (tmp_path / "again.yaml").write_text("mine")
    with pytest.raises(ChangedOnDiskError):
        EditedFile(tmp_path / "again.yaml").save("x", "")


def test_a_new_file_can_begin_as_a_copy(tmp_path):
    file = EditedFile(tmp_path / "lab.yaml", like="simple_train")
    world = read_world(file.state().text).world
    assert (world.name, len(world.obstacles)) == ("lab", 7)
    (tmp_path / "ours.yaml").write_text("name: theirs   # ours\nformat: 1\nsize: [4, 4]\n")
    begun = EditedFile(tmp_path / "new.yaml", like=str(tmp_path / "ours.yaml")).state().text
    assert begun == "name: new   # ours\nformat: 1\nsize: [4, 4]\n"
    (tmp_path / "b.yaml").write_text("")
    with pytest.raises(WorldError, match="exists already"):
        EditedFile(tmp_path / "b.yaml", like="simple_train")
    with pytest.raises(WorldError, match="there is no such world; name a file or one of"):
        EditedFile(tmp_path / "c.yaml", like="simple_trian")


@pytest.mark.parametrize("stem", ["true", "null"])
def test_a_new_file_may_have_any_name(tmp_path, stem):
    assert read_world(EditedFile(tmp_path / f"{stem}.yaml").state().text).world.name == stem


@pytest.mark.parametrize("name", ['"a#b: c"', "lab#3", ">-\n  two\n  lines", "'it''s'   # ours"])
def test_a_copy_has_the_new_files_name_whatever_the_others_is(tmp_path, name):
    (tmp_path / "ours.yaml").write_text(f"format: 1\nname: {name}\nsize: [4, 4]\n")
    text = EditedFile(tmp_path / "new.yaml", like=str(tmp_path / "ours.yaml")).state().text
    assert read_world(text).world.name == "new"
    assert ("# ours" in text) == ("# ours" in name)


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("room", None, "name a new one with .yaml"),
        ("no/where.yaml", None, "there is no directory"),
        ("binary.yaml", b"\xff\xfe", "is not UTF-8 text"),
        ("large.yaml", b"#" * (LARGEST_TEXT + 1), "is larger than 4 MiB"),
        (
            "simple_train",
            None,
            "shipped world; edit a copy: navsim world edit my_simple_train.yaml --like simple_train",
        ),
        (".", None, "is a directory"),
    ],
)
def test_what_cannot_become_a_world_file_is_told(tmp_path, monkeypatch, name, content, message):
    monkeypatch.chdir(tmp_path)
    if content is not None:
        (tmp_path / name).write_bytes(content)
    with pytest.raises(WorldError, match=message):
        EditedFile(name)


def test_a_port_that_is_taken_is_told(room, server):
    with pytest.raises(WorldError, match="leave --port out"):
        edit(EditedFile(room), port=server.server_address[1], open_browser=False)
    with pytest.raises(WorldError, match="between 0 and 65535"):
        edit(EditedFile(room), port=70_000, open_browser=False)


def test_the_address_is_printed_the_browser_opened_and_ctrl_c_ends_it(room, capsys, monkeypatch):
    opened = threading.Event()
    addresses = []

    def open_page(address):
        addresses.append(address)
        opened.set()

    def wait_for_the_browser(self):
        assert opened.wait(10)
        raise KeyboardInterrupt

    monkeypatch.setenv("DISPLAY", ":0")
    monkeypatch.setattr(server_module.webbrowser, "open", open_page)
    monkeypatch.setattr(EditorServer, "serve_forever", wait_for_the_browser)
    edit(EditedFile(room))
    printed = capsys.readouterr().out
    assert addresses[0].startswith("http://127.0.0.1:")
    assert addresses[0] in printed
    assert "Ctrl-C ends" in printed


def test_the_command_serves_the_page_until_it_is_interrupted(room):
    command = [sys.executable, "-m", "rl.cli", "world", "edit", str(room), "--no-browser"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        lines = [process.stdout.readline() for _ in range(3)]
        address = re.search(r"http://127\.0\.0\.1:\d+/\S+/", lines[1]).group()
        with urllib.request.urlopen(address, timeout=20) as page:
            assert b"navsim world editor" in page.read()
        process.send_signal(signal.SIGINT)
        try:
            out, err = process.communicate(timeout=60)
        finally:
            process.kill()
    assert (process.returncode, out.strip(), err) == (0, "", "")
    assert lines[0] == f"editing {room} at\n"
    assert room.read_text() == ROOM
