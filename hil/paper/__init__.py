"""The paper's tables, figures and claims, measured on the rig: `hil paper`."""
