"""A headless Chromium, where there is one: a page as a browser shows it and prints it."""

import re
import shutil
import subprocess
from dataclasses import dataclass
from pathlib import Path

import pytest

CHROMIUM = next(
    (found for name in ("chromium", "chromium-browser", "google-chrome", "chrome") if (found := shutil.which(name))),
    None,
)
needs_chromium = pytest.mark.skipif(CHROMIUM is None, reason="no Chromium is installed to show the page")

_MEASURED = """<script>
const root = document.documentElement, right = root.clientWidth + 0.5;
const narrow = root.clientWidth < 700;
const scrolled = one => narrow && getComputedStyle(one.closest(".wide")).overflowX === "auto";
const wide = [...document.querySelectorAll("main *")].filter(
  one => !(one.matches(".wide *") && scrolled(one)) && one.getBoundingClientRect().right > right);
const broken = [...document.images].filter(image => !image.naturalWidth).length;
root.dataset.said = [root.clientWidth, root.scrollWidth, wide.length, broken].join(" ");
</script></body>"""


@dataclass(frozen=True)
class Shown:
    """How a page lies in a window: widths in px, elements beyond the edge, images that cannot be shown."""

    client: int
    scroll: int
    wide: int
    broken: int
    complaints: str


def browse(folder: Path, page: Path, *options: str) -> subprocess.CompletedProcess[str]:
    """Open a page; the browser's own files go to a folder."""
    assert CHROMIUM is not None
    bare = ["--headless", "--no-sandbox", "--hide-scrollbars", f"--user-data-dir={folder / 'profile'}"]
    quiet = ["--disable-gpu", "--no-first-run", "--disable-background-networking", "--disable-component-update"]
    # Whatever it has to say on its own is on standard error; a page's messages are there as CONSOLE.
    logged = ["--enable-logging=stderr", "--log-level=0"]
    command = [CHROMIUM, *bare, *quiet, *logged, *options, page.as_uri()]
    return subprocess.run(command, capture_output=True, text=True, timeout=120, check=True)


def show(folder: Path, html: str, width: int = 1280) -> Shown:
    """Lay a page out in a window; in a narrow one what moves sideways within its own place is not beyond the edge."""
    page = folder / "page.html"
    page.write_text(html.replace("</body>", _MEASURED), encoding="utf-8")
    shown = browse(folder, page, f"--window-size={width},900", "--dump-dom")
    said = re.search(r'data-said="([^"]*)"', shown.stdout)
    assert said is not None
    complaints = "\n".join(line for line in shown.stderr.splitlines() if "CONSOLE" in line)
    client, scroll, wide, broken = (int(part) for part in said[1].split())
    return Shown(client, scroll, wide, broken, complaints)
