"""The folders that verbs write: one implementation of lock, same request, resume and removal (`folder`).

`manifest` is reconstruction.json: what was asked (`Request`), what was found (`Known`), hashes of the inputs,
findings. Whoever reads a result needs it alone; `reconstruction` writes it. `frame_log` names the frames that
are complete on disk. `sequences` is a moving mesh, appended frame by frame and read as a memory map. `seams`
are polylines on the template image.
"""
