"""Calibration on a bare head that turns: tracks, poses, hull, stereo, fusion, light (brostow2011, IV)."""
