"""The gel: contact, friction, elastic layer and creep."""
