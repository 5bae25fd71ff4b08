"""All benchmarks, one after the other, and what each measured as JSON.

python -m benchmarks [--out bench.json] [--only NAME ...] [--data FOLDER]      # 30 min

Each runs in a process of its own, so that the peak of memory is its own. FOLDER is handed to those that
measure on real data. A benchmark that fails is reported and does not stop the others.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

# name -> its arguments beyond --out and --data
BENCHMARKS: dict[str, list[str]] = {
    "integration": ["--largest", "2048"],
    "painted_objects": [],
    "shadows": [],
    "mistakes": ["--seeds", "1"],
    "tracking": [],
    "skinning": [],
    "export": [],
    "pipeline": [],
    "live": [],
    "cluster": [],
    "calibrate_head": [],
    "chroma": [],
}
DATA_FOLDERS = {
    "integration": "normal_integration",
    "painted_objects": "normal_integration",
    "shadows": "",
}  # inside --data


def run(name: str, extra: list[str], data: Path | None, folder: Path) -> dict[str, Any]:
    """Run one benchmark; return its JSON where it writes one, its text, seconds and peak memory."""
    script = Path(__file__).parent / f"{name}.py"
    text = script.read_text()
    out = folder / f"{name}.json"
    command = [sys.executable, "-m", f"benchmarks.{name}", *extra]
    if '"--out"' in text:
        command += ["--out", str(out)]
    if data is not None and name in DATA_FOLDERS:
        command += ["--data", str(data / DATA_FOLDERS[name])]
    started = time.perf_counter()
    printed, complaints = folder / f"{name}.out", folder / f"{name}.err"
    with printed.open("w") as stdout, complaints.open("w") as stderr:
        process = subprocess.Popen(command, stdout=stdout, stderr=stderr)
        _, status, usage = os.wait4(process.pid, 0)
    result: dict[str, Any] = {
        "command": " ".join(["python", *command[1:]]),
        "seconds": round(time.perf_counter() - started, 1),
        "peak_mb": usage.ru_maxrss // 1024,
    }
    if status:
        return result | {"failure": (complaints.read_text().strip().splitlines() or ["no message"])[-1]}
    if out.exists():
        return result | {"result": json.loads(out.read_text())}
    return result | {"text": printed.read_text().splitlines()}


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    default = os.environ.get("VNTOOLKIT_REAL_DATA")
    parser.add_argument("--out", type=Path, default=Path("bench.json"))
    parser.add_argument(
        "--only", nargs="+", choices=list(BENCHMARKS), default=list(BENCHMARKS), metavar="NAME"
    )
    parser.add_argument("--data", type=Path, default=Path(default) if default else None)
    arguments = parser.parse_args()
    results: dict[str, Any] = {
        "machine": {"cpus": os.cpu_count(), "processor": platform.machine(), "python": sys.version.split()[0]}
    }
    with tempfile.TemporaryDirectory() as folder:
        for name in arguments.only:
            load = os.getloadavg()[0]
            results[name] = run(name, BENCHMARKS[name], arguments.data, Path(folder)) | {"load_before": load}
            outcome = "failed: " + results[name]["failure"] if "failure" in results[name] else "done"
            print(f"{name}: {outcome} in {results[name]['seconds']:.0f} s", flush=True)
            arguments.out.write_text(json.dumps(results, indent=1) + "\n")
    print(f"{arguments.out}: {len(arguments.only)} benchmarks")


if __name__ == "__main__":
    main()
