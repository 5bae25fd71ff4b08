"""Captures in: video, images, folders; decoded, linear, frame by frame."""
