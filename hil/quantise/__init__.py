"""What 16-bit words do to the joints: ranges, head-room, overflows, and the error beside float64."""
