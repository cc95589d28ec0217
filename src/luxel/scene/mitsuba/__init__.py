"""Mitsuba 3 scene files: what Mitsuba itself has read, turned into plain data, kind by kind."""

from luxel.scene.mitsuba.xml import load_mitsuba_xml

__all__ = ["load_mitsuba_xml"]
