"""The contract: the CAN database, the frames, the codec made from it."""
