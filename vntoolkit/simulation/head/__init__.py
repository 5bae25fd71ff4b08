"""A human head: a shipped neutral shape, slit at lips and lids, moved by muscles, and its scenes.

`HeadRig` turns an `Expression` (how far each `Muscle`, jaw and lid moves) and a `HeadPose` into vertices, in
centimetres in the head's frame. `scenes` builds `head_turn`, `face` and `face_makeup` from it (Figures 2, 3
and 8 of brostow2011), with freckles, pores, brows and hair, or with make-up.
"""
