"""A human head: a shipped neutral shape, slit at lips and lids, moved by muscles (`rig`), and its scenes."""
