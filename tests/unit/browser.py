"""Reports in a real browser, for tests: what the page draws, answers, and says on its console."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
from pathlib import Path
from typing import Any

import pytest
from pages import Page

CHROMIUM = next((found for name in ("chromium", "chromium-browser", "google-chrome")
                 if (found := shutil.which(name))), None)  # fmt: skip
needed = pytest.mark.skipif(CHROMIUM is None, reason="no browser here: apt-get install chromium")
TRY = """<script>(function () {
  const out = {ink: [], before: document.body.className};
  for (const canvas of document.querySelectorAll(".uplot canvas")) {
    const pixels = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height).data;
    let ink = 0;
    for (let i = 3; i < pixels.length; i += 4) ink += pixels[i] > 0;
    out.ink.push(ink);
  }
  const over = document.querySelector(".u-over"), box = over.getBoundingClientRect();
  const at = {clientX: box.left + 0.5 * box.width, clientY: box.top + 9, bubbles: true};
  over.dispatchEvent(new MouseEvent("mousemove", at));
  document.querySelector("[data-act=in]").click();
  out.zoomed = document.body.className;
  setTimeout(() => {
    out.hover = [...document.querySelectorAll(".uplot")].map((u) =>
      [...u.querySelectorAll(".u-value")].map((v) => v.textContent));
    document.querySelector("[data-act=all]").click();
    out.after = document.body.className;
    const finger = (id, x) => new Touch({identifier: id, target: over,
      clientX: box.left + x * box.width, clientY: box.top + 9});
    const pinch = (type, a, b) => over.dispatchEvent(new TouchEvent(type,
      {touches: [finger(1, a), finger(2, b)], bubbles: true, cancelable: true}));
    pinch("touchstart", 0.4, 0.6);
    out.kept = !pinch("touchmove", 0.1, 0.9);
    out.pinched = document.body.className;
    const block = document.querySelector(".lane i");
    if (block) block.click();
    out.blocked = document.body.className;
    out.wide = document.documentElement.scrollWidth - innerWidth;
    const place = document.createElement("p");
    place.id = "found";
    place.textContent = JSON.stringify(out);
    document.body.append(place);
  }, 300);
})();</script></body>"""


def browse(path: Path, *options: str) -> tuple[Page, str]:
    """Return the page as the browser has it after a while, and what it wrote on its console."""
    assert CHROMIUM is not None
    command = [
        CHROMIUM,
        "--headless=new",
        "--no-sandbox",
        "--disable-gpu",
        f"--user-data-dir={path.parent / 'profile'}",
        "--enable-logging=stderr",
        "--virtual-time-budget=8000",
        *options,
        path.as_uri(),
    ]
    env = {**os.environ, "HOME": str(path.parent)}
    done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=120, env=env)
    console = [line for line in done.stderr.splitlines() if "CONSOLE" in line]
    return Page(done.stdout), "\n".join(console)


def tried(text: str, folder: Path, *options: str) -> tuple[Page, dict[str, Any]]:
    """Open a page, hover and zoom; return it and what was found."""
    path = folder / "tried.html"
    path.write_text(text.replace("</body>", TRY), encoding="utf-8")
    found, console = browse(path, "--dump-dom", *options)
    assert console == ""
    return found, json.loads(found.inside["found"])
