"""How deep the skin is pressed: growth of the discs from events, indentation from the field."""
