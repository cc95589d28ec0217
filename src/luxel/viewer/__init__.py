"""See it live: a world that many visitors look at in their browsers, each with a camera of their own.

`session` is the engine and knows no browser; `app` and `panels` are its face, on viser.
"""

from __future__ import annotations
