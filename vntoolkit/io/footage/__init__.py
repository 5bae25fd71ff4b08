"""Captures: videos, images, folders and patterns become linear frames, one at a time.

`Capture` opens a source and streams `LinearFrame`s; `sequence` finds which files are its frames; `video`
decodes by PyAV, and `video_index` reads packets alone; `image_sequence` and `images` by OpenCV, OpenEXR and
LibRaw, `mosaics` Bayer data; `io/recordings` reads MCAP. What a file states about itself (curve, range,
primaries, orientation, pixel format) is used or refused by name. `decoding` turns stored samples into linear
light in one pass; `luma_detail` reads the fine relief of 4:2:0 footage from its luma. `mattes` says where
the subject is.
"""
