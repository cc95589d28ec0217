"""Every method that luxel knows, by its name."""

from __future__ import annotations

from luxel.methods.base import Method
from luxel.methods.ddgi.method import Ddgi
from luxel.methods.gibs.method import Gibs
from luxel.methods.lightmap.method import Lightmap
from luxel.methods.path_tracer import PathTracer
from luxel.methods.trivial import Ambient, NoIndirect

METHODS: dict[str, Method] = {
    method.name: method for method in (NoIndirect(), Ambient(), PathTracer(), Gibs(), Ddgi(), Lightmap())
}
