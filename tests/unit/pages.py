"""The text of an HTML page, and whether it is whole and stands alone."""

from __future__ import annotations

from collections.abc import Mapping
from html.parser import HTMLParser
from typing import Any

import numpy as np


class Page(HTMLParser):
    """Collects the text, marked numbers, and what would be loaded from elsewhere.

    ``inside`` has the text of every element with an id and of no other element; ``numbers`` has
    (key in the summary, scale, text).
    """

    def __init__(self, text: str) -> None:
        super().__init__()
        self.words: list[str] = []
        self.loaded: list[str] = []
        self.open: list[str] = []
        self.tags: list[str] = []
        self.inside: dict[str, str] = {}
        self.numbers: list[tuple[str, float, str]] = []
        self._last: dict[str, str | None] = {}
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self._last = dict(attrs)
        if tag not in ("meta", "img", "br"):
            self.open.append(tag)
        for name, value in attrs:
            if name in ("src", "href") and not (value or "").startswith("data:"):
                self.loaded.append(str(value))

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag
        self._last = {}

    def handle_data(self, data: str) -> None:
        self.words.append(data)
        if self._last.get("id"):
            name = str(self._last["id"])
            self.inside[name] = self.inside.get(name, "") + data
        if self._last.get("data-key"):
            scale = float(self._last.get("data-scale") or 1.0)
            self.numbers.append((str(self._last["data-key"]), scale, data))

    def check_numbers(self, summary: Mapping[str, Any]) -> None:
        """Compare every marked number with the summary's, as far as digits are shown."""
        for key, scale, text in self.numbers:
            value: Any = summary
            for part in key.split("."):
                value = value[int(part) if isinstance(value, list) else part]
            if value is None:
                assert text == "n/a", key
                continue
            shown = float(text.rstrip("\u2033\u00b0% m").replace(",", ""))
            tolerance = 0.0 if isinstance(value, int) else max(0.005 * abs(shown), 1e-12)
            np.testing.assert_allclose(shown, scale * value, atol=tolerance, rtol=0, err_msg=key)
