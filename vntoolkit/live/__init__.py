"""Floor 3, the camera's frames while filming: sources, processing, recorder, server, page."""
