"""Floor 3, the stages joined to jobs: one file per job, streaming frames, one worker or many."""
