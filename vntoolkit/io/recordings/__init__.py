"""Recordings of robots: MCAP files of ROS 2 messages in and out, and recordings for the Rerun viewer.

`mcap_footage` reads the pictures of one topic as the frames of a capture; `mcap_messages` writes depth and
contact as messages; `rerun_file` writes all of a result on one timeline. The libraries are extras of the
package: `pip install 'vntoolkit[mcap]'`, `'vntoolkit[rerun]'`. What is written is a `RecordedFrame`
at a time.
"""
