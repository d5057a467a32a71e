"""Fetch libmujoco.so.3.17.0 from the PyPI wheel into FOLDER, checked by hash. Standard library and pip only.

Usage: fetch_mujoco.py FOLDER
pip's own configuration (index, proxy, certificates) is honoured. The cp311 wheel is asked for whatever Python runs
this, so that everybody gets the same file.
"""

import hashlib
import os
import subprocess
import sys
import tempfile
import zipfile

VERSION = "3.17.0"
LIBRARY = f"libmujoco.so.{VERSION}"
WHEEL_SHA256 = "d66928d86a2d1b601bbaa4dc11db50214d17d5301bb8afd84721313b67ff0874"
LIBRARY_SHA256 = "23496b023ee80fb61ab71167e94bc649f9941710fde96b18bb8204fb332523ad"


def main(folder):
    os.makedirs(folder, exist_ok=True)
    # A sibling of the target, so that the final rename stays on one file system and is atomic.
    with tempfile.TemporaryDirectory(dir=folder, prefix=".fetch-") as work:
        requirements = os.path.join(work, "requirements.txt")
        with open(requirements, "w", encoding="ascii") as file:
            file.write(f"mujoco=={VERSION} --hash=sha256:{WHEEL_SHA256}\n")
        subprocess.run(
            [sys.executable, "-m", "pip", "download", "--quiet", "--disable-pip-version-check", "--no-deps",
             "--only-binary=:all:", "--implementation", "cp", "--python-version", "3.11", "--abi", "cp311",
             "--platform", "manylinux_2_28_x86_64", "--require-hashes", "--requirement", requirements, "--dest", work],
            check=True, stdout=sys.stderr, timeout=600,
        )
        wheel = next(os.path.join(work, name) for name in os.listdir(work) if name.endswith(".whl"))
        with zipfile.ZipFile(wheel) as archive:
            data = archive.read(f"mujoco/{LIBRARY}")
        found = hashlib.sha256(data).hexdigest()
        if found != LIBRARY_SHA256:
            sys.exit(f"{LIBRARY} has sha256 {found}, expected {LIBRARY_SHA256}")
        unpacked = os.path.join(work, LIBRARY)
        with open(unpacked, "wb") as file:
            file.write(data)
        # cargo compares this time with the build's: a fresh one would repeat the build.
        os.utime(unpacked, (0, 0))
        os.replace(unpacked, os.path.join(folder, LIBRARY))


if __name__ == "__main__":
    try:
        main(sys.argv[1])
    except subprocess.CalledProcessError as error:
        sys.exit(f"pip download failed with exit code {error.returncode}")
    except subprocess.TimeoutExpired as error:
        sys.exit(f"pip download did not finish within {error.timeout:.0f} s")
