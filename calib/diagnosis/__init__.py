"""Find where simulation and measurement disagree, name the missing effect, add it, show the gap shrink."""
