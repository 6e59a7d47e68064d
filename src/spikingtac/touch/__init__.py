"""What is felt: touches, the field's quantities, forces, slip and vibration."""
