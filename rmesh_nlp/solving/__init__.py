"""What every strategy returns, and the referee that judges it."""
