"""Contact-free motion of the grasped probe with sparse rendering, for rates of false stops."""
