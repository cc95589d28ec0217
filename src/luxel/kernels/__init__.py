"""Stateless Dr.Jit functions; one file is one idea and has one test."""
