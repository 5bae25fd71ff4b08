"""Floor 2, calibration: M from pairs of normal and colour on a board, a ball, presses or a head."""
