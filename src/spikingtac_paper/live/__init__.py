"""The live runtime under load and under faults: ``spikingtac bench live``."""
