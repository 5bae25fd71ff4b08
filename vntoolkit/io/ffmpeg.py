"""FFmpeg through PyAV: files opened quietly, by names that are never protocols, with errors on one line."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from vntoolkit.errors import BadCapture


def open_video(path: Path) -> tuple[Any, Any]:
    """Return the container of a video file, which the caller closes, and its first video stream.

    Raises `BadCapture` where FFmpeg cannot open it, or it holds no video.
    """
    import av

    # Errors arrive as exceptions, in one line. PyAV's own log callback waits, in FFmpeg's threads, for
    # Python's lock, and does so for ever where Python holds it and waits for these threads to end.
    av.logging.restore_default_callback()
    av.logging.set_libav_level(av.logging.PANIC)
    try:
        container = _opened(file_name(path))
    except av_errors() as error:
        raise BadCapture(
            f"{path}: cannot be opened as a video ({reason_of(error)}); it is damaged, cut off or "
            "in an unknown format"
        ) from error
    if not container.streams.video:
        container.close()
        raise BadCapture(f"{path}: holds no video stream")
    return container, container.streams.video[0]


def _opened(name: str) -> Any:
    """Open a file whose title, author or other tag may be no UTF-8; none of them is read here.

    PyAV up to 18 raises `UnicodeDecodeError` unless told otherwise; from 19 on it hands such bytes on as lone
    surrogates, and has no option for it.
    """
    import av

    try:
        return av.open(name)
    except UnicodeDecodeError:
        return av.open(name, metadata_errors="replace")


def file_name(path: Path) -> str:
    """Return what FFmpeg takes for a file: `take:1.mkv`, unlike `/home/take:1.mkv`, were a protocol."""
    return str(path.absolute())


def av_errors() -> tuple[type[Exception], ...]:
    """Return what PyAV raises; it is imported only when asked for."""
    import av

    return (av.error.FFmpegError, OSError, EOFError)


def reason_of(error: Exception) -> str:
    """Return FFmpeg's reason on one line."""
    return " ".join(str(getattr(error, "strerror", None) or error).split()).lower()
