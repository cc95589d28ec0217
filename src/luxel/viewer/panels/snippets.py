"""A piece of text to be copied: wrapped where the window ends, with a button that puts it on the clipboard."""

from __future__ import annotations

from html import escape

COPY = """
const text = this.closest('.luxel-snippet').querySelector('code'), done = () => {
  this.textContent = 'Copied'; setTimeout(() => { this.textContent = 'Copy'; }, 1500); };
const select = () => { const range = document.createRange(); range.selectNodeContents(text);
  const selection = getSelection(); selection.removeAllRanges(); selection.addRange(range);
  if (document.execCommand('copy')) done(); };
if (navigator.clipboard && isSecureContext) navigator.clipboard.writeText(text.textContent).then(done, select);
else select();
"""
"""Run by the button. A page from another machine has no clipboard of its own: there the text is selected and copied."""
BUTTON = (
    "flex: none; border: 0; border-radius: 0.3em; padding: 0.25em 0.9em; cursor: pointer; font: inherit; "
    "font-size: 0.85em; color: #1b1c1e; background: rgb(240, 170, 60)"
)
CODE = (
    "margin: 0; padding: 0.75em 0.9em; border-radius: 0.4em; background: rgba(0, 0, 0, 0.28); font-size: 0.82em; "
    "line-height: 1.5; max-height: 19em; overflow-y: auto; white-space: pre-wrap; overflow-wrap: anywhere"
)
FONT = "font-family: ui-monospace, Menlo, Consolas, monospace"


def draw_snippet(title: str, text: str) -> str:
    """Return `text` as HTML under its `title`, with a button that copies it as it is."""
    button = f'<button type="button" style="{BUTTON}" onclick="{escape(COPY)}">Copy</button>'
    return (
        '<div class="luxel-snippet" style="padding: 0.3em 0 0.7em">'
        '<div style="display: flex; justify-content: space-between; align-items: center; padding-bottom: 0.4em">'
        f"<b>{escape(title)}</b>{button}</div>"
        f'<pre style="{CODE}"><code style="{FONT}">{escape(text)}</code></pre>'
        "</div>"
    )
