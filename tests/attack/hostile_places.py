"""What is no file, or does not stay what it was, where a file should be.

Files that may not be read are not tried: tests may run as root, who reads them all.
"""

from __future__ import annotations

import os
import socket
import threading
import time
from collections.abc import Callable
from pathlib import Path
from random import Random

from tests.attack.specimens import Specimen, specimens

_DEVICES = tuple(
    d
    for d in ("/dev/zero", "/dev/urandom", "/dev/null", "/dev/full", "/dev/tty")
    if Path(d).exists()
)


def _instead(make: Callable[[Path], object]) -> Callable[[Path], None]:
    def place(path: Path) -> None:
        path.unlink()
        make(path)

    return place


def _socket(path: Path) -> None:
    with socket.socket(socket.AF_UNIX) as made:
        folder = os.open(path.parent, os.O_RDONLY)  # names of sockets may not be long
        try:
            made.bind(f"/proc/self/fd/{folder}/{path.name}")
        finally:
            os.close(folder)


def _folder_with_something(path: Path) -> None:
    path.mkdir()
    (path / "x").touch()


def _any(
    random: Random, place: Callable[[Path], None], but: tuple[str, ...] = ("spec",)
) -> Specimen:
    known = specimens()
    specimen = known[
        random.choice([name for name, specimen in known.items() if specimen.door not in but])
    ]
    return Specimen(specimen.name, specimen.door, specimen.content, specimen.beside, place)


def devices(random: Random) -> Specimen:
    """A link to a device."""
    device = random.choice(_DEVICES)
    return _any(random, _instead(lambda path: path.symlink_to(device)))


def pipes(random: Random) -> Specimen:
    """A pipe that nobody writes to, a socket that nobody listens to."""
    return _any(random, _instead(random.choice((os.mkfifo, os.mkfifo, _socket))))


def links(random: Random) -> Specimen:
    """A link to nowhere, to itself, to the folder; a folder of the file's name."""
    make = random.choice(
        (
            lambda path: path.symlink_to("nowhere"),
            lambda path: path.symlink_to(path.name),
            lambda path: path.symlink_to("."),
            Path.mkdir,
            _folder_with_something,
        )
    )
    return _any(random, _instead(make))


def moving(random: Random) -> Specimen:
    """A file that vanishes, shrinks or grows while it is read."""
    pause, act = random.random() * 0.01, random.randrange(4)

    def move(path: Path) -> None:
        time.sleep(pause)
        try:
            size = path.stat().st_size
            if act == 0:
                path.unlink()
            elif act == 1:
                os.truncate(path, size // 2)
            else:
                with path.open("ab") as file:
                    for _ in range(1 if act == 2 else 100):
                        file.write(bytes(10**5))
        except OSError:  # the next trial has begun
            pass

    written_too = ("recent", "preferences")
    return _any(
        random,
        lambda path: threading.Thread(target=move, args=(path,)).start(),
        ("spec", *written_too),
    )


def holes(random: Random) -> Specimen:
    """A file of many gigabytes of which nothing is on the disk."""
    size = random.choice((2**31, 2**33, 2**40))
    return _any(random, lambda path: os.truncate(path, size))


MAKERS = (devices, pipes, links, moving, holes)
