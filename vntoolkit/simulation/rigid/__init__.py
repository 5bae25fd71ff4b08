"""Scenes whose surface does not deform: a ball, a paper-wrapped cylinder, the calibration board, a jacket."""
