"""Floor 3, the stages joined: one file a job, streaming, one worker or many."""
