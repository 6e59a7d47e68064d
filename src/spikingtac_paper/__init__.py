"""The paper's experiments, run again: methods x trials -> predictions -> scores -> report."""
