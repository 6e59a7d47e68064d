"""Tasks that need touch, as Gymnasium environments."""
