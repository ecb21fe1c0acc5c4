"""What the site does to its pages: options in code are not broken after their hyphens."""

from __future__ import annotations

import re
from typing import Any


def on_page_content(html: str, **_: Any) -> str:
    """A page with each option of its code in a span that is not broken (`assets/tables.css`)."""
    option = re.compile(r"(?<![\w-])--[a-z][a-z-]*")
    span = r'<span class="option">\g<0></span>'
    return re.sub(r"<code[^>]*>.*?</code>", lambda code: option.sub(span, code[0]), html, flags=re.DOTALL)
