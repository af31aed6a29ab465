#!/usr/bin/env python3
"""Builds the documents as a site: build_site.py ROOT WORK writes WORK/site, which opens from the disk.

Copies docs/, the Markdown files of the root and the README of every plugin into WORK/docs, as mkdocs wants all pages in
one folder, mends the links between them, and runs `mkdocs build --strict`. A link to a file that is not a page of the site
becomes the file's name as code. Every page must be in the navigation of mkdocs.yml.
"""
import os
import pathlib
import re
import shutil
import subprocess
import sys

import yaml  # also needed by mkdocs

from check_documents import LINK, documents


def site_name(name):
    """Where a file of the source tree lies on the site; None if it is not part of the site."""
    pages = {"README.md": "readme/weft.md", "CHANGELOG.md": "changes.md", "CONTRIBUTING.md": "contributing.md",
             "MIGRATION.md": "migration.md"}
    if match := re.fullmatch(r"plugins/(\w+)/(\w+)/README\.md", name):
        return f"plugins/{match[1]}/{match[2]}.md"
    return pages.get(name) or (name[len("docs/"):] if name.startswith("docs/") else None)


def mend(root, page, text):
    """The page's text with links as the site needs them."""
    here = pathlib.PurePosixPath(site_name(page.relative_to(root).as_posix())).parent

    def link(match):
        target, hash_sign, anchor = match[2].partition("#")
        if not target or re.match(r"[a-z]+:", target):
            return match[0]
        name = (page.parent / target).resolve().relative_to(root).as_posix()
        if site_name(name) is None:
            return f"`{name}`"
        opening = match[0][: match[0].rindex("](")]
        return f"{opening}]({os.path.relpath(site_name(name), here)}{hash_sign}{anchor})"

    # Blocks and code stay as they are.
    return re.sub(r"(?ms)^```.*?^```|`[^`]*`|" + LINK.pattern, lambda m: m[0] if m[2] is None else link(m), text)


def nav_pages(nav):
    for entry in nav:
        for value in entry.values():
            yield from nav_pages(value) if isinstance(value, list) else [value]


def main():
    root, work = (pathlib.Path(argument).resolve() for argument in sys.argv[1:3])
    shutil.rmtree(work, ignore_errors=True)
    shutil.copytree(root / "docs", work / "docs")
    for page in documents(root):
        copy = work / "docs" / site_name(page.relative_to(root).as_posix())
        copy.parent.mkdir(parents=True, exist_ok=True)
        copy.write_text(mend(root, page, page.read_text()))
    config = (root / "mkdocs.yml").read_text()
    (work / "mkdocs.yml").write_text(config)
    pages = {page.relative_to(work / "docs").as_posix() for page in (work / "docs").rglob("*.md")}
    if missing := pages - set(nav_pages(yaml.safe_load(config)["nav"])):
        sys.exit(f"mkdocs.yml: nav lacks {', '.join(sorted(missing))}")
    command = ["mkdocs", "build", "--strict", "--quiet", "--config-file", work / "mkdocs.yml", "--site-dir", work / "site"]
    sys.exit(subprocess.run(command, check=False).returncode)


if __name__ == "__main__":
    main()
