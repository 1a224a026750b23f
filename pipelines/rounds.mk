# A robot works in rounds and learns as it drives: make -f rounds.mk
#
# A round is a share of the budget: a shift, a charge of the battery. In it the robot drives legs. A leg plans with what
# budget is left from where the robot stands, drives, and learns from all drives so far how drivable the classes are:
#   round-1/leg-1/scoremap.tif  plan.json  drive.jsonl  scores.json        round-1/report.json  plan.png
# A leg for which nothing is left stays where it is.
#
# Your own robot: robot=real plans, and stops where it wants the log of a drive. A drive.jsonl that `hrt drive` did not
# write is never replaced or deleted, whatever becomes of its plan; put into the place of a simulated drive, what comes
# after follows it.

.DEFAULT_GOAL := rounds
include Makefile

.PHONY: rounds clean-rounds
rounds:

ifeq ($(filter clean%,$(MAKECMDGOALS)),)
ifeq ($(filter simulated real,$(robot)),)
$(error $(CONFIG): robot is simulated or real, not '$(robot)')
endif
ifeq ($(robot) $(world),simulated )
$(error $(CONFIG): the simulated robot needs a world: the folder of a site, as `hrt synth` makes one)
endif
endif

count = $(shell awk 'BEGIN { for (k = 1; k <= $(1); k++) print k }')
all_rounds := $(call count,$(rounds))
all_legs := $(call count,$(legs))
# Budgets are cumulative: twice 5min after the second round.
budgets := $(shell LC_ALL=C awk 'BEGIN { unit = "$(round_budget)"; sub(/^[0-9.]+/, "", unit); \
  for (k = 1; k <= $(rounds); k++) print k * "$(round_budget)" unit }')

world_files := $(if $(world),$(wildcard $(addprefix $(world)/,ortho.tif ortho.vrt dsm.tif truth.tif classes.tif world.json)))
world_args := $(if $(world),--world $(world))

# The drives of a real robot: those that carry no provenance.
drives := $(foreach r,$(all_rounds),$(foreach l,$(all_legs),round-$r/leg-$l/drive.jsonl))
driven := $(wildcard $(drives))
driven := $(if $(driven),$(shell grep -L '"provenance"' $(driven)))

ifeq ($(filter clean%,$(MAKECMDGOALS)),)
$(call stamp,rounds-legs,$(legs))
$(call stamp,rounds-scoremap,$(scoremap_args))
$(foreach r,$(all_rounds),$(call stamp,rounds-plan-$r,$(ortho) $(start) $(word $r,$(budgets)) $(planner_args)))
$(call stamp,rounds-feedback,$(scores))
$(call stamp,rounds-drive,$(world) $(local) $(seed))
$(call stamp,rounds-report,$(world) $(legs))
# A log copied with its time may be older than what it replaces, so what is in it counts, not when it was written.
$(foreach log,$(driven),$(call stamp,$(subst /,-,$(log)),$(shell cksum < $(log))))
endif

# What the legs before have left, as the legs are gone through in order.
logs :=
log_stamps :=
learnt := $(scores)
last_log :=
# With fewer legs a round, what stood between two of them is gone: no file is newer for it.
legs_before = $(if $(filter-out 1,$1),$(stamps)/rounds-legs)

leg_plan = $(HRT) plan $1/scoremap.tif -o $1/plan.json $(if $(logs),$(logs:%=--visited %),--start $(start)) --or-stay \
  --budget $(word $2,$(budgets)) $(planner_args)

# $1 folder of the leg, $2 round, $3 leg. Recipes, too, are expanded here, while `logs` are those of the legs before.
define leg
$1:
	@mkdir -p $$@

$1/scoremap.tif: $(out)/classes.tif $(learnt) $(layers) $(stamps)/rounds-scoremap $(call legs_before,$2) | $1
	$(HRT) scoremap $(out)/classes.tif -o $$@ $(cell_args) $(if $(learnt),--scores $(learnt)) --overwrite -q
	@touch $$@

$1/plan.json: $1/scoremap.tif $(policies) $(logs) $(log_stamps) $(stamps)/rounds-plan-$2
	$(call leg_plan,$1,$2) --overwrite
	@touch $$@

$(if $(filter 1,$3),$(call plan_figure,$1,$2))

$(call $(if $(or $(filter real,$(robot)),$(filter $1/%,$(driven))),real,simulated)_drive,$1,$2,$3)

$(eval logs += $1/drive.jsonl)$(eval log_stamps += $(if $(filter $1/%,$(driven)),$(stamps)/$(subst /,-,$1/drive.jsonl)))
$1/scores.json: $(out)/classes.tif $(scores) $(logs) $(log_stamps) $(stamps)/rounds-feedback $(call legs_before,$2)
	$(HRT) feedback $(logs) --classes $(out)/classes.tif $(if $(scores),--scores $(scores)) -o $$@ --overwrite -q
	@touch $$@
$(eval learnt := $1/scores.json)$(eval last_log := $1/drive.jsonl)
endef

# The first plan of a round is drawn by the command that made it, which finds it up to date.
define plan_figure
round-$2/plan.png: $1/plan.json
	$(call leg_plan,$1,$2) --figure $$@ --backdrop $(ortho) --overwrite
endef

define simulated_drive
$1/drive.jsonl: $1/plan.json $(last_log) $(world_files) $(stamps)/rounds-drive
	$(HRT) drive $1/plan.json $(world_args) $(if $(last_log),--after $(last_log)) -o $$@ --local $(local) \
	  --seed $$$$(( $(seed) * 1000 + $2 * 50 + $3 )) --overwrite
	@touch $$@
endef

# The drive is not made again when its plan is: it was driven.
define real_drive
$1/drive.jsonl: | $1/plan.json
	@if grep -q '"method": "stay"' $1/plan.json; then \
	  $(HRT) drive $1/plan.json --stay $(if $(last_log),--after $(last_log)) -o $$@; \
	else \
	  echo 'Error: $$@: no such log: let the robot drive $1/plan.json, put its log there and run make again' >&2; \
	  exit 1; \
	fi
endef

$(foreach r,$(all_rounds),$(foreach l,$(all_legs),$(eval $(call leg,round-$r/leg-$l,$r,$l))))

# $1 round, $2 its logs, $3 their stamps.
define report
round-$1/report.json: $2 $3 round-$1/leg-$(lastword $(all_legs))/scoremap.tif $(world_files) $(stamps)/rounds-report
	$(HRT) evaluate drive $2 $(world_args) --scoremap round-$1/leg-$(lastword $(all_legs))/scoremap.tif --json -q > $$@
endef

$(foreach r,$(all_rounds),$(eval $(call report,$r,$(filter round-$r/%,$(drives)),\
  $(filter $(stamps)/round-$r-%,$(log_stamps)))))

rounds: $(foreach r,$(all_rounds),round-$r/report.json round-$r/plan.png round-$r/leg-$(lastword $(all_legs))/scores.json)

# The drives of a real robot stay.
clean-rounds:
	rm -f $(filter-out $(driven),$(foreach file,scoremap.tif scoremap.qml plan.json drive.jsonl scores.json,\
	  $(drives:drive.jsonl=$(file)))) $(foreach r,$(all_rounds),round-$r/report.json round-$r/plan.png)
	rm -f $(stamps)/rounds-* $(stamps)/round-*
	-rmdir $(patsubst %/drive.jsonl,%,$(drives)) $(all_rounds:%=round-%) 2> /dev/null
