#!/usr/bin/env python3
"""Runs the line that installs the packages of the containers, in a new Debian 12: container_packages.py [--resolve] [--keep]

Makes a system with mmdebstrap (Debian's package; it needs root) in a temporary folder, from the machine's own sources of
packages, and runs there the line of containers/Dockerfile, which containers/weft.def must have too. That downloads about
1 GB, so it is done by hand. With --resolve apt only says what it would install, and a few small packages are installed.
Exit code 0: it works; 1: it does not; 77: mmdebstrap, root or the packages' server is missing, and nothing was tested.
"""

import argparse
import os
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent.parent
MOST_S = 400  # for the system, which takes 20 s of CPU time


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


SMALL = ("ninja-build", "nlohmann-json3-dev", "libcli11-dev")  # of the list; they need no others
NO_SERVER = ("Failed to fetch", "Could not resolve", "Could not connect", "Unable to connect", "Connection failed")


class NothingTested(Exception):
    """The machine cannot do it."""


class Failed(Exception):
    """The recipe does not work."""


def install_line():
    """The recipes' line. @throws Failed if they have different ones."""
    found = []
    for name, end in (("Dockerfile", "\nCOPY "), ("weft.def", "\n    cmake ")):
        text = (ROOT / "containers" / name).read_text()
        line = re.search(r"apt-get update.*?(?=" + end + ")", text, re.DOTALL)
        if line is None:
            raise Failed(f"containers/{name} installs nothing")
        found.append(line.group())
    if found[0].split() != found[1].split():
        raise Failed("containers/Dockerfile and containers/weft.def install different packages")
    return found[0]


def packages_of(line):
    """What the line names."""
    words = line[line.index("--no-install-recommends"):line.index(" && \\\n")].replace("\\", " ").split()
    return words[1:]


class System:
    """A new Debian 12 in a folder."""

    def __init__(self, folder):
        self._root = folder / "system"
        # It is thrown away, so nothing waits for the disk, and nobody reads its manuals.
        options = ["--skip=cleanup/apt/lists", "--dpkgopt=force-unsafe-io",
                   *(f"--dpkgopt=path-exclude=/usr/share/{name}/*" for name in ("man", "doc", "locale")),
                   "--aptopt=Acquire::Retries \"1\"", "--aptopt=Acquire::http::Timeout \"15\""]
        try:
            made = subprocess.run(["mmdebstrap", "--mode=root", "--variant=apt", "--quiet", *options, "bookworm",
                                   str(self._root), "-"], input="\n".join(sources()) + "\n", text=True, check=False,
                                  stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, timeout=MOST_S)
        except subprocess.TimeoutExpired:
            raise NothingTested(f"mmdebstrap made no system within {MOST_S} s") from None
        if made.returncode != 0:
            raise NothingTested(f"mmdebstrap made no system: {made.stderr.strip()[-1000:]}")
        # The network as this machine reaches it.
        for name in ("etc/resolv.conf", "etc/hosts"):
            shutil.copy(f"/{name}", self._root / name)
        for name in Path("/etc/apt/apt.conf.d").glob("*"):
            if "Proxy" in name.read_text(errors="replace"):
                shutil.copy(name, self._root / "etc/apt/apt.conf.d" / name.name)
        policy = self._root / "usr/sbin/policy-rc.d"
        policy.write_text("#!/bin/sh\nexit 101\n")  # starts no services
        policy.chmod(0o755)

    def only_simulate(self):
        (self._root / "etc/apt/apt.conf.d/99simulate").write_text('APT::Get::Simulate "true";\n')

    def run(self, line):
        """@return the exit code of a line of shell, and what it printed."""
        end = subprocess.run(["chroot", str(self._root), "sh", "-ec", line], check=False, text=True, stdin=subprocess.DEVNULL,
                             stdout=subprocess.PIPE, stderr=subprocess.STDOUT, errors="replace")
        return end.returncode, end.stdout

    def must(self, line):
        """@return what it printed. @throws Failed; NothingTested if the packages' server did not answer."""
        code, text = self.run(line)
        if code != 0:
            raise (NothingTested if any(words in text for words in NO_SERVER) else Failed)(f"{line}: {text[-2000:]}")
        return text


def install_all(system, line):
    system.must(line)
    for program in ("g++", "cmake", "ninja", "node", "npm"):
        system.must(f"{program} --version")
    return "every package was installed"


def resolve_all(system, line):
    packages = packages_of(line)
    if missing := set(SMALL) - set(packages):
        raise Failed(f"the line does not install {missing}")
    system.must(f"apt-get update && DEBIAN_FRONTEND=noninteractive apt-get install -y --no-install-recommends {' '.join(SMALL)}")
    system.must("ninja --version && test -e /usr/include/nlohmann/json.hpp -a -e /usr/include/CLI/CLI.hpp")
    code, text = system.run("apt-get install -y weft-has-no-such-package")
    if code == 0 or "Unable to locate package" not in text:
        raise Failed(f"a package that does not exist was not refused: {text[-500:]}")
    system.only_simulate()
    text = system.must(line)
    would = set(re.findall(r"^Inst (\S+)", text, re.MULTILINE)) | set(SMALL)
    if left_out := [name for name in packages if name not in would]:
        raise Failed(f"apt would not install {', '.join(left_out)}")
    return f"apt installs all {len(packages)} packages, {len(would)} with those that they need"


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--resolve", action="store_true", help="install a few packages; of all, ask apt what it would do")
    parser.add_argument("--keep", action="store_true", help="do not remove the system")
    options = parser.parse_args()
    folder = None
    try:
        line = install_line()
        if shutil.which("mmdebstrap") is None:
            raise NothingTested("mmdebstrap is not installed")
        if os.getuid() != 0:
            raise NothingTested("this needs root")
        folder = Path(tempfile.mkdtemp(prefix="weft-container-"))
        folder.chmod(0o755)
        system = System(folder)
        print((resolve_all if options.resolve else install_all)(system, line))
    except NothingTested as problem:
        print(f"NOTHING WAS TESTED: {problem}")
        return 77
    except Failed as problem:
        print(f"failed: {problem}")
        return 1
    finally:
        if folder is not None and options.keep:
            print(f"kept: {folder}")
        elif folder is not None:
            # What is still mounted in it stays.
            subprocess.run(["rm", "-rf", "--one-file-system", str(folder)], check=False)
    return 0


if __name__ == "__main__":
    sys.exit(main())
