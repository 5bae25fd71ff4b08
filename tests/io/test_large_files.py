"""Large files are written whole, past the file cache or through it, and none is left half-written."""

import errno
import os

import numpy as np
import pytest

from vntoolkit.errors import CannotWrite
from vntoolkit.io.atomic import aligned_memory, write_large

SIZES = [0, 5, 1 << 20, (1 << 20) + 4097, (3 << 20) - 1]


def filled(size):
    memory = aligned_memory(size)
    memory[:] = np.random.default_rng(size).integers(0, 256, size, np.uint8)
    return memory


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("offset", [0, 1])  # memory off the boundary cannot go past the cache
def test_a_file_holds_its_content(tmp_path, size, offset):
    content = filled(size + offset)[offset:]
    write_large(tmp_path / "a.exr", content.data)
    assert (tmp_path / "a.exr").read_bytes() == content.tobytes()
    assert [path.name for path in tmp_path.iterdir()] == ["a.exr"]


def test_memory_begins_on_a_boundary():
    assert all(aligned_memory(size).ctypes.data % 4096 == 0 for size in (1, 5000, 3 << 20))


@pytest.mark.skipif(not hasattr(os, "O_DIRECT"), reason="the system has no way past its cache")
@pytest.mark.parametrize("refused", ["flag", "write"])
def test_a_file_system_that_cannot_go_past_its_cache_uses_it(tmp_path, monkeypatch, refused):
    import fcntl

    real, asked = fcntl.fcntl, []

    def answer(file, command, *value):
        if command == fcntl.F_SETFL and value[0] & os.O_DIRECT:
            asked.append(value[0])
            if refused == "flag":
                raise OSError(errno.EINVAL, "Invalid argument")
        return real(file, command, *value)

    monkeypatch.setattr(fcntl, "fcntl", answer)
    content = filled((1 << 20) + 4097 + 8)[8 if refused == "write" else 0 :]  # the disk refuses the address
    write_large(tmp_path / "a.ply", content.data)
    assert asked
    assert (tmp_path / "a.ply").read_bytes() == content.tobytes()


@pytest.mark.skipif(not hasattr(os, "O_DIRECT"), reason="the system has no way past its cache")
def test_a_full_disk_is_one_line_and_leaves_nothing(tmp_path, monkeypatch):
    import fcntl

    real = fcntl.fcntl

    def answer(file, command, *value):
        if command == fcntl.F_SETFL and value[0] & os.O_DIRECT:
            raise OSError(errno.ENOSPC, "No space left on device")
        return real(file, command, *value)

    monkeypatch.setattr(fcntl, "fcntl", answer)
    with pytest.raises(CannotWrite, match="free some space"):
        write_large(tmp_path / "a.exr", filled(2 << 20).data)
    assert not list(tmp_path.iterdir())
