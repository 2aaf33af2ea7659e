"""The door by which files come in: only plain files, only as much as they hold, and no bombs."""

import errno
import gzip
import os
import socket
import zlib
from pathlib import Path

import pytest

from abfm.errors import one_line
from abfm.reading import inflated, open_plain, read_bytes


def test_a_file_comes_whole(tmp_path):
    (tmp_path / "a").write_bytes(b"\r\n\0whole")
    (tmp_path / "link").symlink_to("a")
    assert read_bytes(tmp_path / "a") == read_bytes(tmp_path / "link") == b"\r\n\0whole"


def test_what_is_no_plain_file_is_refused_and_nothing_waits(tmp_path, monkeypatch):
    os.mkfifo(tmp_path / "pipe")
    monkeypatch.chdir(tmp_path)
    (tmp_path / "link").symlink_to("pipe")
    with socket.socket(socket.AF_UNIX) as server:
        server.bind("socket")
        for name, kind in (
            *(("pipe", "a pipe"), ("link", "a pipe"), ("socket", "a socket")),
            *(("/dev/zero", "a device"), ("/dev/urandom", "a device"), (".", "directory")),
            *(("none", "No such file"), ("none\0", "No such file"), ("a" * 300, "too long")),
        ):
            with pytest.raises(OSError, match=kind) as caught:
                read_bytes(name)
            assert kind in caught.value.strerror


def test_a_file_that_becomes_a_pipe_before_it_is_opened_is_refused(tmp_path, monkeypatch):
    (tmp_path / "a").touch()
    os.mkfifo(tmp_path / "pipe")
    plain = os.stat(tmp_path / "a")
    monkeypatch.setattr(os, "stat", lambda _: plain)
    with pytest.raises(OSError, match="a pipe"):
        read_bytes(tmp_path / "pipe")


def test_no_more_is_read_than_there_was_and_than_is_allowed(tmp_path):
    (tmp_path / "a").write_bytes(bytes(100))
    with pytest.raises(OSError, match="100 bytes, and at most 99") as caught:
        read_bytes(tmp_path / "a", most=99)
    assert caught.value.errno == errno.EFBIG
    with open_plain(tmp_path / "a", most=100) as file:
        assert file.read() == bytes(100)


@pytest.mark.parametrize("packed", [gzip.compress, zlib.compress])
def test_compressed_data_comes_back_up_to_a_bound(packed):
    content = os.urandom(1000) + bytes(9000)
    data = packed(content)
    assert inflated(data) == inflated(data, most=10_000) == content
    with pytest.raises(ValueError, match="hold more than 9999"):
        inflated(data, most=9999)
    damaged = bytearray(data)
    damaged[len(data) // 2] ^= 1
    for bad in (data[:1], data[:10], data[:-1], bytes(damaged)):
        with pytest.raises(ValueError, match="damaged or cut short"):
            inflated(bad)


def test_a_bomb_is_refused_when_it_has_given_its_bound():
    with pytest.raises(ValueError, match="hold more than 67108864"):
        inflated(gzip.compress(bytes(80 << 20), 1))


@pytest.mark.parametrize(
    ("given", "line"),
    [
        (ValueError("a\n\tb\x1b[31m\u202e"), "a b?[31m?"),
        (MemoryError(), "MemoryError"),
        (FileNotFoundError(2, "No such file", "/a/b"), "No such file"),
        (Path("/a\nb/\udcff"), "/a b/?"),
        (ValueError("x" * 1000), "x" * 147 + "..." + "x" * 50),
        ("y" * 200, "y" * 200),
    ],
)
def test_whatever_is_told_fits_one_line(given, line):
    assert one_line(given) == line
