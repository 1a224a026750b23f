# A robot learns to steer from a survey, before it has driven a metre: make -f steer.mk world=../site
#
# Glances are what it would see at random places of the site, most of them with something in the way. Round 1 shows it
# besides how the expert drives, who sees the site as it is. In each later round the robot itself drives, and the expert
# says what it should have done there, and helps it on where it gets stuck (DAgger: Ross, Gordon and Bagnell 2011); it
# learns from all so far:
#   glances/labels.csv  round-1/drive-1/labels.csv  drive-1.jsonl  ...  steer.safetensors  curve.png
#   test/drive-1.jsonl  ...  report.json
# From several sites (steer_worlds) it learns likewise: each has glances of its own (glances, glances-2, ...), and the
# drives go by turns over all.
# The courses are random legs over the site (hrt drive --roam), others in the test than in training.

.DEFAULT_GOAL := steering
include Makefile

.PHONY: steering learning clean-steering
steering:

ifeq ($(filter clean%,$(MAKECMDGOALS)),)
ifeq ($(world),)
$(error $(CONFIG): to learn to steer, a robot needs a world: the folder of a site with ortho.tif and dsm.tif)
endif
endif

count = $(shell awk 'BEGIN { for (k = 1; k <= $(1); k++) print k }')
learn_rounds := $(call count,$(steer_rounds))
ifeq ($(filter clean%,$(MAKECMDGOALS)),)
$(foreach key,steer_epochs steer_rate,$(if $(filter $(words $(learn_rounds)),\
  $(words $(wordlist 1,$(words $(learn_rounds)),$($(key))))),,\
  $(error $(CONFIG): $(key) needs a number for each of the $(steer_rounds) rounds, not '$($(key))')))
endif
learn_drives := $(call count,$(steer_drives))
steer_out := $(out)/steer
site_files = $(wildcard $(addprefix $1/,ortho.tif ortho.vrt dsm.tif truth.tif classes.tif world.json))
learn_worlds := $(world) $(steer_worlds)
world_count := $(words $(learn_worlds))
# The site of a drive.
world_of = $(word $(shell echo $$(( ($1 - 1) % $(world_count) + 1 ))),$(learn_worlds))
roam_args = --roam $(steer_metres)
# It is pushed off its way now and then, so that it shows how to get back.
push_args = --local teacher --disturb $(steer_disturb)
train_args = --balance $(steer_balance) --size $(steer_size) --crop-top $(steer_crop) --columns $(steer_columns) \
  --batch $(steer_batch) --sigma $(steer_sigma) --share 0.1 --patience 0 --threads $(workers)
glance_args = --frames $(shell echo $$(( $(steer_glances) / $(world_count) ))) --near $(steer_near)

ifeq ($(filter clean%,$(MAKECMDGOALS)),)
$(call stamp,steer-drive,$(learn_worlds) $(roam_args) $(seed) $(steer_drives))
$(call stamp,steer-push,$(push_args))
$(call stamp,steer-train,$(train_args) $(steer_epochs) $(steer_rate) $(seed))
$(call stamp,steer-glances,$(learn_worlds) $(glance_args) $(seed))
endif

# $1 number of a site, $2 its folder.
define glances
$(steer_out)/glances$(if $(filter-out 1,$1),-$1)/labels.csv: $(call site_files,$2) $(stamps)/steer-glances
	$(HRT) record $2 -o $$(@D) $(glance_args) --seed $$$$(( $(seed) + $1 - 1 )) --overwrite
	@touch $$@
$(eval recordings += $(steer_out)/glances$(if $(filter-out 1,$1),-$1)/labels.csv)
endef

# $1 round, $2 drive, $3 who drives, $4 what that depends on.
define learning_drive
$(steer_out)/round-$1/drive-$2/labels.csv: $(call site_files,$(call world_of,$2)) $4 $(stamps)/steer-drive
	@mkdir -p $$(@D)
	$(HRT) drive --world $(call world_of,$2) $(roam_args) -o $(steer_out)/round-$1/drive-$2.jsonl --record $$(@D) $3 \
	  --seed $$$$(( $(seed) * 100000 + $1 * 1000 + $2 )) --overwrite
	@touch $$@
$(eval recordings += $(steer_out)/round-$1/drive-$2/labels.csv)
endef

# $1 round. Recipes, too, are expanded here, while `recordings` are those of the rounds so far.
define learning_round
$(foreach d,$(learn_drives),$(eval $(call learning_drive,$1,$d,\
  $(if $(learnt),--local steer --model $(learnt) --rescue,$(push_args)),$(if $(learnt),$(learnt),$(stamps)/steer-push))))
$(steer_out)/round-$1/steer.safetensors: $(recordings) $(learnt) $(stamps)/steer-train
	$(HRT) train-steer $(patsubst %/labels.csv,%,$(recordings)) -o $$@ $(train_args) --epochs $(word $1,$(steer_epochs)) \
	  --learning-rate $(word $1,$(steer_rate)) \
	  $(if $(learnt),--init $(learnt)) --seed $(seed) --curve $$(@D)/curve.png --overwrite
	@touch $$@
$(eval learnt := $(steer_out)/round-$1/steer.safetensors)
endef

recordings :=
ifneq ($(filter-out 0,$(steer_glances)),)
$(foreach k,$(call count,$(world_count)),$(eval $(call glances,$k,$(word $k,$(learn_worlds)))))
endif
learnt :=
$(foreach r,$(learn_rounds),$(eval $(call learning_round,$r)))

learning: $(learnt)

# What it learnt, on courses that it has not seen, here or on another site.
test_logs := $(foreach d,$(call count,$(steer_test_drives)),$(steer_out)/test/drive-$d.jsonl)
test_world := $(if $(steer_test_world),$(steer_test_world),$(world))
test_files := $(call site_files,$(test_world))

ifeq ($(filter clean%,$(MAKECMDGOALS)),)
$(call stamp,steer-test,$(test_world) $(steer_metres) $(seed))
endif

$(steer_out)/test/drive-%.jsonl: $(learnt) $(test_files) $(stamps)/steer-test
	@mkdir -p $(@D)
	$(HRT) drive --world $(test_world) --roam $(steer_metres) -o $@ --local steer --model $(learnt) \
	  --seed $$(( $(seed) * 100000 + 99000 + $* )) --overwrite
	@touch $@

$(steer_out)/test/report.json: $(test_logs) $(test_files)
	$(HRT) evaluate drive $(test_logs) --world $(test_world) --json -q > $@

steering: $(steer_out)/test/report.json

clean-steering:
	rm -rf $(steer_out)
	rm -f $(stamps)/steer-*
