"""What is felt: forces of a real gel, wrenches and touches on the twin."""
