"""A GigE Vision camera that serves any GenICam description: its nodes, its registers, its behaviour."""
