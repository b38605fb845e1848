"""The inner problem: contact on a fixed mesh, solved exactly."""
