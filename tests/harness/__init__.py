"""Helpers that tests of several folders share: processes, ports, emulated arms and people."""
