"""Which view to record next: candidates for target poses (view_candidates), what each would add
(recorded_view), and the best of them (next_best_view)."""
