"""Transcription of a problem by a method: functions, rows of inequalities, boundary conditions, guess."""
