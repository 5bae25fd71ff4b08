"""The stages joined to jobs: one file a job, frames streamed, one process or many, the same result.

`reconstruct` goes one way. A `Request` is what was asked; the manifest stores it. `prepare` finds once
what holds for the whole capture (`Known`: materials, lamps, blur, findings). `FrameProcessor` turns a
frame into a `FrameResult` without hidden state; what one frame hands to the next is one `Carried`.
`write_frame` writes it, and a run that was interrupted goes on. `frame_blocks`, `processes` and
`cluster` spread frames over workers, which know nothing of photometry.

The other jobs: `calibrate`, `calibrate_head`, `calibrate_presses`, `simulate`, `track`, `dress`, `export`,
`evaluate`, `session`, `demo`. `opened_result` and `tracked_folder` read what was written.
"""
