#!/usr/bin/env python3
"""Installs what the containers install, in a new Debian 12: container_packages.py [--keep]

Makes a system with mmdebstrap (Debian's package; it needs root) in a temporary folder, from the machine's own sources of
packages, and runs there the line that installs packages, as containers/Dockerfile has it. It downloads about 1 GB, so it is
run by hand. Exit code 0: everything could be installed; 1: not; 77: mmdebstrap is not there.
"""

import argparse
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent.parent


def sources():
    """The machine's lines of Debian itself, as the format of one line each."""
    lines = []
    for file in (Path("/etc/apt/sources.list"), *sorted(Path("/etc/apt/sources.list.d").glob("*"))):
        text = file.read_text() if file.is_file() else ""
        if file.suffix == ".sources":
            for block in text.split("\n\n"):
                fields = dict(re.findall(r"^(\w[\w-]*): *(.+)$", block, re.MULTILINE))
                if "debian" in fields.get("URIs", "") and "bookworm" in fields.get("Suites", ""):
                    for suite in fields["Suites"].split():
                        lines.append(f"deb {fields['URIs']} {suite} {fields['Components']}")
        else:
            lines += [line for line in text.splitlines() if re.match(r"deb .*debian.* bookworm", line)]
    return lines or ["deb http://deb.debian.org/debian bookworm main"]


def install_line():
    text = (ROOT / "containers/Dockerfile").read_text()
    return re.search(r"^RUN (apt-get update.*?[^\\])\n[A-Z]", text, re.MULTILINE | re.DOTALL).group(1)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--keep", action="store_true", help="do not remove the system")
    options = parser.parse_args()
    if shutil.which("mmdebstrap") is None:
        print("NOTHING WAS TESTED: mmdebstrap is not installed")
        return 77
    folder = Path(tempfile.mkdtemp(prefix="weft-container-"))
    folder.chmod(0o755)
    system = folder / "system"
    try:
        subprocess.run(["mmdebstrap", "--mode=root", "--variant=minbase", "--quiet", "bookworm", str(system), "-"],
                       input="\n".join(sources()) + "\n", text=True, check=True)
        # The network as this machine reaches it.
        for name in ("etc/resolv.conf", "etc/hosts"):
            shutil.copy(f"/{name}", system / name)
        for name in Path("/etc/apt/apt.conf.d").glob("*"):
            if "Proxy" in name.read_text(errors="replace"):
                shutil.copy(name, system / "etc/apt/apt.conf.d" / name.name)
        (system / "usr/sbin/policy-rc.d").write_text("#!/bin/sh\nexit 101\n")  # starts no services
        (system / "usr/sbin/policy-rc.d").chmod(0o755)
        (system / "etc/dpkg/dpkg.cfg.d/unsafe").write_text("force-unsafe-io\n")  # it is thrown away
        subprocess.run(["chroot", str(system), "sh", "-ec", install_line()], check=True, stdin=subprocess.DEVNULL,
                       stdout=subprocess.DEVNULL)
        for program in ("g++", "cmake", "ninja", "node", "npm"):
            subprocess.run(["chroot", str(system), program, "--version"], check=True, stdout=subprocess.DEVNULL)
    except subprocess.CalledProcessError as error:
        print(f"failed: {error}")
        return 1
    finally:
        if not options.keep:
            # What is still mounted in it stays.
            subprocess.run(["rm", "-rf", "--one-file-system", str(folder)], check=False)
    print("every package was installed")
    return 0


if __name__ == "__main__":
    sys.exit(main())
