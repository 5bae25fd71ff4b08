"""Reading captures: videos, images and folders become linear frames, one at a time."""
