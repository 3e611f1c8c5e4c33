"""What the figures assume, and what is withheld where that does not hold: checks of frames, and remarks."""
