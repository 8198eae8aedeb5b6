"""What a recording is: the Run, bags, recorder, replay, import."""
