"""What a simulation lacks that logs of the car show. `pipeline.diagnose` takes a log this way:

    open         measured/     targets, and blocks for fit, selection and holdout               MeasuredDrive
    recalibrate  estimation/   the model's numbers moved within their priors                    FitSummary
                 diagnostics/  which links stay broken, where, and how it looks                 LinkResidual
    scan         estimation/   every effect of the catalogue fitted alone (model/, workers/)    CandidateScore
    select       selection/    stepwise search; rejection.py drops effects, with the reason     SelectionOutcome
    verdict      selection/    one, several, set, none_missing, none_of_these                   Verdict
    afterwards   validation/   the repaired model, and free runs of it on the holdout blocks    BlockErrors

An effect that the plant or the logs cannot have is no candidate (`untestable_effects`), and one whose grid gains too
little is not fitted (workers/pool.py). A name is rejected by its score (selection/criteria.py; in the scan, and in each
step of selection/search.py), by what the selected effects explain (selection/rejection.py), by the verdict
(selection/verdict.py), or by the holdout blocks (jobs/gap/acceptance.py). Each rejection is a Reason
(selection/reasons.py) in gap.json: every effect of the catalogue is named, is in the set, or has one. result.py writes
the Diagnosis as gap.json, and makes cannot_test of none_missing where no effect could have shown; result_text.py makes
the texts, last.
"""
