"""How far the events are behind the motion."""
