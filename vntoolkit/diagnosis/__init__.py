"""Floor 2, whether footage, rig and result can be trusted."""
