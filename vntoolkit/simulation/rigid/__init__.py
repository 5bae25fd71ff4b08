"""Scenes whose surface does not deform: ball, cylinder, calibration board, jacket; and a gel that is
pressed.
"""
