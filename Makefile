# blobfield: one Makefile, no recursion. `make help` lists the targets.

CC ?= cc
CFLAGS ?= -O2 -g
PREFIX ?= /usr/local
DESTDIR ?=
SYSCONFDIR ?= $(if $(filter /usr,$(PREFIX)),/etc,$(PREFIX)/etc)
MANDIR ?= $(PREFIX)/share/man
UNITDIR ?= $(PREFIX)/lib/systemd/system
SYSUSERSDIR ?= $(PREFIX)/lib/sysusers.d
# Where `make run` listens.
LISTEN ?= 127.0.0.1:7878
# SAN=address,undefined or SAN=thread builds and tests with sanitizers.
SAN ?=
# V=1 shows the commands.
V ?=
# Seconds each fuzzer runs in `make fuzz`.
FUZZ_SECONDS ?= 60
# Requests of `make soak`.
SOAK_REQUESTS ?= 1000000
# Parts of `make bench`: device scale tables mesh wire start; none: all.
BENCH_PARTS ?=

comma := ,
B := build$(if $(SAN),/$(subst $(comma),-,$(SAN)))
Q := $(if $(V),,@)
VERSION := $(shell sed -n 's/^\#\# \([0-9][0-9.]*\).*/\1/p' CHANGELOG.md | head -1)

PACKAGES := gcc libc6-dev libcurl4-openssl-dev libmicrohttpd-dev \
	libcjson-dev nettle-dev libgnutls28-dev libhiredis-dev libsqlite3-dev \
	libsystemd-dev libpng-dev libxxhash-dev ocl-icd-opencl-dev \
	pocl-opencl-icd
RUN_PACKAGES := curl
TEST_PACKAGES := libcmocka-dev curl clang valgrind wrk \
	python3 python3-jsonschema python3-numpy python3-prometheus-client \
	mypy admesh assimp-utils chromium redis-server redis-tools haproxy \
	gnutls-bin mandoc openssl systemd
# Node.js for the previewer's bundle and its tests, from Debian if there is none.
NODE_PACKAGES = $(if $(shell command -v npm),,nodejs npm)
BLENDER_PACKAGES := blender python3-numpy
FIGURE_PACKAGES := python3-numpy python3-matplotlib
DEB_PACKAGES := debhelper fakeroot
PACKAGE_TEST_PACKAGES := debootstrap lintian systemd-container
FUZZ_PACKAGES := clang libclang-rt-14-dev python3-jsonschema

WARN := -Wall -Wextra -Wpedantic -Wshadow -Wstrict-prototypes \
	-Wmissing-prototypes -Wvla -Wpointer-arith -Wwrite-strings \
	-Werror=implicit-function-declaration -Werror=int-conversion
ALL_CFLAGS := -std=c11 -D_GNU_SOURCE -I. -MMD -MP $(WARN) -fno-math-errno \
	-DBLOBFIELD_VERSION='"$(VERSION)"' -DCL_TARGET_OPENCL_VERSION=120 \
	$(if $(SAN),-fsanitize=$(SAN) -fno-omit-frame-pointer \
	-fno-sanitize-recover=all) $(CFLAGS)
ALL_LDFLAGS := -pthread $(if $(SAN),-fsanitize=$(SAN)) $(LDFLAGS)
LIBS := -lmicrohttpd -lcjson -lnettle -lpng -lOpenCL \
	-lsqlite3 -lhiredis -lgnutls -lsystemd -lm

objects = $(patsubst %.c,$(B)/%.o,$(wildcard $(1)/*.c))
programs = $(patsubst %.c,$(B)/%,$(wildcard tests/$(1)/test_*.c))

CORE := $(call objects,core)
PROTO := $(call objects,proto)
KERNELS := $(call objects,kernels) $(B)/kernels/source.o
SERVER := $(call objects,server) $(B)/server/assets.o
SUPPORT := $(B)/tests/support.a
# The C client: a library, of which only blobfield_* is seen, and the command.
LIBCLIENT := $(addprefix $(B)/clients/c/,blobfield.o events.o surface.o \
	transfer.o)
COMMAND := $(filter-out $(LIBCLIENT),$(call objects,clients/c)) \
	$(addprefix $(B)/proto/,json.o json_place.o arena.o fault.o text.o \
	number.o number_print.o npy.o)
CLIENT := $(B)/blobfield $(B)/libblobfield.a
UNIT := $(call programs,unit)
DEVICE := $(call programs,device)
WIRE := $(call programs,wire)
CLIENTS := $(call programs,clients)
SCRIPTS := $(wildcard tests/wire/test_*.py tests/clients/test_*.py \
	tests/clients/test_*.sh)
WEB_STAMP := clients/web/node_modules/.package-lock.json
WEB_TESTS := $(wildcard tests/web/test_*)
# Libraries that make the daemon's calls fail.
FAULTS := $(patsubst tests/fault/%.c,$(B)/tests/fault/%.so,\
	$(wildcard tests/fault/fail_*.c))
# What takes ten seconds and more is begun first, the longest before all.
TEST_LONGEST := web/test_web.mjs wire/test_hostile.py wire/test_cache \
	device/test_accuracy wire/test_scale_out.py clients/test_python.py \
	wire/test_shutdown device/test_lookup wire/test_faults wire/test_orders \
	wire/test_animation wire/test_systemd.py clients/test_c.py \
	wire/test_scenes wire/test_crash.py wire/test_keep wire/test_log \
	unit/test_mesh_topology wire/test_tls.py wire/test_events \
	wire/test_framing wire/test_device_loss wire/test_mesh_programs.py \
	wire/test_metrics wire/test_drain.py unit/test_server_scheduler \
	device/test_tiles wire/test_stream wire/test_tasks wire/test_access \
	web/test_bundle.mjs
VERDICTS := $(B)/tests/schema/document_verdicts
BENCH := $(B)/tests/bench/bench
SOAK := $(B)/tests/load/soak
FUZZ := $(patsubst tests/fuzz/%.c,build/fuzz/%,$(wildcard tests/fuzz/fuzz_*.c))

# What the kernels are made of. Order matters: constants shared with C, types,
# functions, entry points.
CL := $(addprefix core/,opcode.h tile.h output.h descriptor.h curve.h \
	table_shape.h warp.h classic.h convolution.h) \
	$(addprefix kernels/,prelude.cl convolution.cl primitive.cl volume.cl \
	warp.cl curve.cl fetch.cl table.cl classic.cl compose.cl surface.cl \
	interpreter.cl)

# What is compiled into the daemon as it is: server/asset.c.
ASSETS := $(addprefix clients/web/dist/,index.html app.js app.css) \
	proto/openapi.json

# Their exit status is none that the daemon or cmocka ends with.
export ASAN_OPTIONS ?= exitcode=66
export TSAN_OPTIONS ?= halt_on_error=1:exitcode=66
export UBSAN_OPTIONS ?= print_stacktrace=1:exitcode=66
export BLOBFIELDD ?= $(B)/blobfieldd
export DOCUMENT_VERDICTS ?= $(VERDICTS)
export BLOBFIELD ?= $(B)/blobfield
export BLOBFIELD_LIBRARY ?= $(B)/libblobfield.a
export SAN

.PHONY: all
all: $(B)/blobfieldd $(CLIENT)

.PHONY: help
help:
	@echo 'make            build the daemon, build/blobfieldd'
	@echo 'make run        install what is missing, build, start the daemon on'
	@echo '                LISTEN=$(LISTEN), post an example to it, serve'
	@echo 'make example    the same on a free port, and stop'
	@echo 'make test       install what is missing, run every test'
	@echo '                (SAN=address,undefined or SAN=thread: sanitized)'
	@echo 'make web        bundle the previewer anew (needs Node.js)'
	@echo 'make test-contract  check the daemon against proto/openapi.json'
	@echo 'make test-blender   test the add-on in a Blender without a window'
	@echo 'make blender-addon  build/blobfield_addon.zip, to be installed in Blender'
	@echo 'make figures    the figures of the paper, through the daemon'
	@echo 'make bench      measure tables and evaluation'
	@echo 'make soak       SOAK_REQUESTS=$(SOAK_REQUESTS) small requests; memory must stay'
	@echo 'make fuzz       run each fuzzer for FUZZ_SECONDS=$(FUZZ_SECONDS)'
	@echo 'make install    to PREFIX=$(PREFIX), with man pages, configuration and'
	@echo '                systemd units; uninstall takes it back'
	@echo 'make deb        build/blobfield_$(VERSION)-1_ARCH.deb, for apt install'
	@echo 'make test-package  build that, install it in a small system, boot it'
	@echo 'make clean      remove build/'

# --- building ---------------------------------------------------------------

$(B)/blobfieldd: $(SERVER) $(KERNELS) $(PROTO) $(CORE)
	$(if $(Q),@echo '  LD    $@')
	$(Q)$(CC) $(ALL_LDFLAGS) -o $@ $^ $(LIBS)

$(B)/libblobfield.a: $(LIBCLIENT)
	$(if $(Q),@echo '  AR    $@')
	$(Q)ld -r -o $@.o $^ && \
	    objcopy -w --keep-global-symbol='blobfield_*' $@.o
	$(Q)rm -f $@ && ar rcs $@ $@.o && rm -f $@.o

$(B)/blobfield: $(COMMAND) $(B)/libblobfield.a
	$(if $(Q),@echo '  LD    $@')
	$(Q)$(CC) $(ALL_LDFLAGS) -o $@ $^ -lcurl -lcjson -lm

$(B)/%.o: %.c
	$(if $(Q),@echo '  CC    $@')
	@mkdir -p $(@D)
	$(Q)$(CC) $(ALL_CFLAGS) -c -o $@ $<

# The version is compiled in.
$(B)/server/%.o $(B)/clients/c/%.o: CHANGELOG.md

# The kernels as one C string; #line lets the device's compiler name the files.
$(B)/kernels/source.c: $(CL) kernels/embed.awk
	@mkdir -p $(@D)
	$(Q)awk -f kernels/embed.awk $(CL) > $@.part && mv $@.part $@

$(B)/kernels/source.o: $(B)/kernels/source.c
	$(if $(Q),@echo '  CC    $@')
	$(Q)$(CC) $(ALL_CFLAGS) -Wno-overlength-strings -c -o $@ $<

$(B)/server/assets.o: $(ASSETS)
	$(if $(Q),@echo '  LD    $@')
	@mkdir -p $(@D)
	$(Q)ld -r -b binary -z noexecstack -o $@ $(ASSETS)

$(SUPPORT): $(call objects,tests/support)
	$(Q)rm -f $@ && ar rcs $@ $^

# The tables' threads, without the rest of the daemon.
$(B)/tests/unit/test_server_tables: $(addprefix $(B)/,$(patsubst %.c,%.o,\
	$(wildcard server/tables*.c)) server/crew.o server/log.o \
	server/table_cache.o kernels/cache_file.o)

# The scheduler, before a device that the test plays.
$(B)/tests/unit/test_server_scheduler: $(addprefix $(B)/,$(patsubst %.c,%.o,\
	$(wildcard server/scheduler*.c)) server/program.o server/surface.o \
	server/pace.o \
	$(patsubst %.c,%.o,$(wildcard server/tables*.c)) \
	server/crew.o server/log.o server/table_cache.o kernels/cache_file.o)

$(B)/tests/unit/test_server_pace: $(B)/server/pace.o
$(B)/tests/unit/test_turns: $(B)/server/turns.o

$(B)/tests/unit/test_config: $(addprefix $(B)/,$(patsubst %.c,%.o,\
	$(wildcard server/config*.c)) server/log.o)

# Log lines, and what is counted, without the rest of the daemon.
$(B)/tests/unit/test_log: $(B)/server/log.o
$(B)/tests/unit/test_http_accept: $(B)/server/http_accept_key.o

$(B)/tests/unit/test_metrics: $(addprefix $(B)/server/,metrics.o \
	metrics_page.o metrics_print.o problem.o)

# Tokens and rates, without exchanges.
$(B)/tests/unit/test_access: UNIT_LIBS := -lnettle
$(B)/tests/unit/test_access: $(addprefix $(B)/server/,token.o token_file.o \
	bucket.o)

# What keeps scenes in Redis, without the store.
$(B)/tests/unit/test_backing_redis: UNIT_LIBS := -lhiredis -lgnutls
$(B)/tests/unit/test_backing_redis: $(addprefix $(B)/,$(patsubst %.c,%.o,\
	$(wildcard server/backing_redis*.c)) server/scene_seq.o server/log.o)

# The files of the cache, without a device.
$(B)/tests/unit/test_table_cache: $(addprefix $(B)/,server/table_cache.o \
	server/log.o kernels/cache_file.o)

# The scene store before a backing that the test plays; and the real one.
$(B)/tests/unit/test_scene_store: $(addprefix $(B)/server/,scene.o \
	scene_apply.o scene_commit.o scene_history.o scene_load.o \
	scene_reader.o scene_seq.o scene_store.o scene_table.o scene_worker.o \
	scene_writer.o etag.o log.o volume_store.o)
$(B)/tests/unit/test_backing_sqlite: $(addprefix $(B)/server/,\
	backing_sqlite.o sqlite_file.o scene_seq.o etag.o log.o)
$(B)/tests/unit/test_scene_store $(B)/tests/unit/test_backing_sqlite: \
	UNIT_LIBS := -lnettle -lsqlite3 -pthread

$(UNIT): $(B)/%: $(B)/%.o $(SUPPORT) $(PROTO) $(CORE)
	$(if $(Q),@echo '  LD    $@')
	$(Q)$(CC) $(ALL_LDFLAGS) -o $@ $^ -lcmocka -lcjson -lpng $(UNIT_LIBS) -lm

$(DEVICE): $(B)/%: $(B)/%.o $(SUPPORT) $(KERNELS) $(PROTO) $(CORE)
	$(if $(Q),@echo '  LD    $@')
	$(Q)$(CC) $(ALL_LDFLAGS) -o $@ $^ -lcmocka -lcjson -lpng -lOpenCL -lm

$(BENCH): $(call objects,tests/bench) $(SUPPORT) $(KERNELS) $(PROTO) $(CORE)
	$(if $(Q),@echo '  LD    $@')
	$(Q)$(CC) $(ALL_LDFLAGS) -o $@ $^ -lmicrohttpd -lcmocka -lcurl -lcjson \
	    -lpng -lOpenCL -lm

$(WIRE): $(B)/%: $(B)/%.o $(SUPPORT) $(PROTO) $(CORE)
	$(if $(Q),@echo '  LD    $@')
	$(Q)$(CC) $(ALL_LDFLAGS) -o $@ $^ -lcmocka -lcurl -lcjson -lpng -lm

$(CLIENTS): $(B)/%: $(B)/%.o $(SUPPORT) $(B)/libblobfield.a
	$(if $(Q),@echo '  LD    $@')
	$(Q)$(CC) $(ALL_LDFLAGS) -o $@ $^ -lcmocka -lcurl -lcjson -lm

$(SOAK): $(B)/%: $(B)/%.o $(SUPPORT)
	$(if $(Q),@echo '  LD    $@')
	$(Q)$(CC) $(ALL_LDFLAGS) -o $@ $^ -lcmocka -lcurl -lm

$(VERDICTS): $(B)/%: $(B)/%.o $(PROTO) $(CORE)
	$(if $(Q),@echo '  LD    $@')
	$(Q)$(CC) $(ALL_LDFLAGS) -o $@ $^ -lcjson -lpng -lm

$(B)/tests/fault/%.so: tests/fault/%.c tests/fault/inside.h tests/fault/fault.h
	$(if $(Q),@echo '  LD    $@')
	@mkdir -p $(@D)
	$(Q)$(CC) $(filter-out -fsanitize=% -MMD -MP,$(ALL_CFLAGS)) -shared \
	    -fPIC -o $@ $< -ldl

# --- packages ---------------------------------------------------------------

# Installs those of the named Debian packages that are missing.
define install_packages
	@missing=$$(for p in $(1); do \
		dpkg-query -W -f='$${Status}' $$p 2>/dev/null | \
		grep -q 'ok installed' || echo $$p; done); \
	[ -z "$$missing" ] || { \
		echo "installing:" $$missing; \
		[ "$$(id -u)" = 0 ] && as= || as=sudo; \
		$$as apt-get update -q && \
		$$as env DEBIAN_FRONTEND=noninteractive \
		apt-get install -y -q --no-install-recommends $$missing; }
endef

.PHONY: packages-run packages-test packages-fuzz packages-blender \
	packages-figures packages-deb packages-test-package
packages-run:
	$(call install_packages,$(PACKAGES) $(RUN_PACKAGES))

packages-test:
	$(call install_packages,$(PACKAGES) $(TEST_PACKAGES) $(NODE_PACKAGES))

packages-deb:
	$(call install_packages,$(PACKAGES) $(DEB_PACKAGES))

packages-test-package:
	$(call install_packages,$(PACKAGE_TEST_PACKAGES))

packages-fuzz:
	$(call install_packages,$(PACKAGES) $(FUZZ_PACKAGES))

packages-blender:
	$(call install_packages,$(PACKAGES) $(BLENDER_PACKAGES))

packages-figures:
	$(call install_packages,$(PACKAGES) $(FIGURE_PACKAGES))

# --- running ----------------------------------------------------------------

.PHONY: run
run: packages-run
	@$(MAKE) --no-print-directory all
	@clients/curl/run.sh $(B)/blobfieldd --listen $(LISTEN)

.PHONY: example
example: packages-run
	@$(MAKE) --no-print-directory $(B)/blobfieldd
	@clients/curl/run.sh --once $(B)/blobfieldd --listen 127.0.0.1:0 \
	    --data :memory:

# --- testing ----------------------------------------------------------------

.PHONY: test
test: packages-test
	@$(MAKE) --no-print-directory -j2 $(B)/blobfieldd $(CLIENT) $(UNIT) \
	    $(DEVICE) $(WIRE) $(CLIENTS) $(VERDICTS) $(FAULTS) check-kernels
	@$(MAKE) --no-print-directory $(WEB_STAMP) || \
	    { echo 'is it the network? npm ping:'; ! npm ping --fetch-retries=0; }
	@TEST_LONGEST='$(TEST_LONGEST)' \
	    tests/run.sh $$([ -e $(WEB_STAMP) ] && echo $(WEB_TESTS) || \
	    echo tests/web/skip.sh) $(SCRIPTS) $(WIRE) $(CLIENTS) $(DEVICE) \
	    tests/schema/test_schema.py $(UNIT)

# What the previewer is bundled and tested with, of the lockfile's versions.
$(WEB_STAMP): clients/web/package-lock.json
	$(if $(Q),@echo '  NPM   clients/web')
	$(Q)cd clients/web && npm ci --ignore-scripts --no-audit --no-fund \
	    --loglevel=error
	@touch $@

# The previewer's bundle, which is kept in the repository.
.PHONY: web
web: $(WEB_STAMP)
	@cd clients/web && npm run --silent build

# The contract: proto/openapi.json linted and compared with the daemon, and all
# wire tests through a proxy that judges every exchange by it.
.PHONY: test-contract
test-contract: packages-test
	@$(MAKE) --no-print-directory -j2 $(B)/blobfieldd $(CLIENT) $(WIRE) \
	    $(CLIENTS) $(FAULTS)
	@cd tests/contract && \
	    { [ node_modules/.package-lock.json -nt package-lock.json ] || \
	    npm ci --ignore-scripts --no-audit --no-fund; }
	@tests/run.sh tests/contract/test_contract.mjs
	@tests/contract/run.sh $(WIRE) $(CLIENTS)

# The add-on, with the Python client inside.
$(B)/blobfield_addon.zip: clients/blender/make_zip.py LICENSE \
	$(wildcard clients/blender/blobfield_addon/*.py \
	clients/python/blobfield/*)
	@mkdir -p $(@D)
	$(Q)clients/blender/make_zip.py $@.part && mv $@.part $@

.PHONY: blender-addon
blender-addon: $(B)/blobfield_addon.zip
	@echo $<

.PHONY: test-blender
test-blender: packages-blender
	@$(MAKE) --no-print-directory -j2 $(B)/blobfieldd blender-addon
	@tests/run.sh tests/blender/test_addon.sh

# The paper's figures, computed through the daemon.
.PHONY: figures
figures: packages-figures
	@$(MAKE) --no-print-directory -j2 $(B)/blobfieldd
	@clients/figures/figures.py

# The kernels' syntax at every width, with no device.
.PHONY: check-kernels
check-kernels:
	@mkdir -p $(B)
	@cat $(CL) > $(B)/kernels.cl
	@for options in -DWIDTH=1 -DWIDTH=4 -DWIDTH=16 \
	    '-DWIDTH=16 -march=skylake-avx512' \
	    '-DWIDTH=1 -DTABLES_IMAGE -DFUSED' '-DWIDTH=16 -DTABLES_IMAGE'; do \
		clang -x cl -cl-std=CL1.2 -Xclang -finclude-default-header \
		    -fsyntax-only -Wall -Werror -Wno-unused-function $$options \
		    $(B)/kernels.cl || exit 1; done

.PHONY: bench
bench: packages-test
	@$(MAKE) --no-print-directory -j2 $(B)/blobfieldd $(BENCH)
	@$(BENCH) --json $(B)/bench.json $(BENCH_PARTS)

.PHONY: soak
soak: packages-test
	@$(MAKE) --no-print-directory -j2 $(B)/blobfieldd $(SOAK) $(FAULTS) \
	    $(B)/tests/wire/test_faults
	@$(SOAK) $(SOAK_REQUESTS)
	@FAULTS=all tests/run.sh $(B)/tests/wire/test_faults
	@CRASH_ROUNDS=300 tests/run.sh tests/wire/test_crash.py
	@STORM_SECONDS=300 tests/run.sh tests/wire/test_storm.py
	@HOSTILE_ROUNDS=12 tests/run.sh tests/wire/test_hostile.py
	@tests/wire/test_scale_out.py 300

# Each fuzzer for a while; how many executions in all.
.PHONY: fuzz
fuzz: packages-fuzz
	@$(MAKE) --no-print-directory -j2 $(FUZZ) $(VERDICTS)
	@tests/schema/test_schema.py $$(($(FUZZ_SECONDS) * 500)) $$(date +%s)
	@tests/fuzz/run.sh build $(FUZZ_SECONDS)

# What the fuzzers are made of, instrumented: all of the daemon but main().
FUZZ_OBJECTS := $(patsubst %.c,build/fuzz/%.o,$(wildcard core/*.c proto/*.c) \
	$(filter-out server/main.c,$(wildcard server/*.c)) kernels/cache_file.c)
# What fuzz_http plays, and how it looks at answers.
FUZZ_PLAY := $(patsubst %.c,build/fuzz/%.o,$(filter-out tests/fuzz/fuzz_%,\
	$(wildcard tests/fuzz/*.c)))
FUZZ_CFLAGS := $(filter-out -Wwrite-strings -fsanitize% -fno-sanitize%,$(ALL_CFLAGS)) -O1 -g \
	-fno-omit-frame-pointer -fsanitize=fuzzer-no-link,address,undefined \
	-fno-sanitize-recover=undefined

build/fuzz/%.o: %.c
	$(if $(Q),@echo '  FUZZ  $@')
	@mkdir -p $(@D)
	$(Q)clang $(FUZZ_CFLAGS) -c -o $@ $<

build/fuzz/daemon.a: $(FUZZ_OBJECTS)
	$(Q)rm -f $@ && ar rcs $@ $^

build/fuzz/fuzz_http: $(FUZZ_PLAY)
build/fuzz/fuzz_http: FUZZ_WRAP := $(addprefix -Wl$(comma)--wrap=table_,\
	build measure sample measure_g)
build/fuzz/fuzz_redis: FUZZ_WRAP := -Wl,--wrap=pthread_cond_timedwait

# The device is played.
$(FUZZ): build/fuzz/fuzz_%: build/fuzz/tests/fuzz/fuzz_%.o build/fuzz/daemon.a \
    $(B)/server/assets.o
	$(if $(Q),@echo '  LD    $@')
	$(Q)clang -pthread -fsanitize=fuzzer,address,undefined $(FUZZ_WRAP) \
	    -o $@ $(filter %.o,$^) $(filter %.a,$^) \
	    $(filter-out -lOpenCL,$(LIBS)) -lxxhash

# --- the rest ---------------------------------------------------------------

# What the README's links lead to, at the same places below it.
DOCS := README.md LICENSE CHANGELOG.md core/README.md proto/README.md \
	proto/DOCUMENT.md proto/document.schema.json proto/openapi.json \
	server/README.md server/OPERATIONS.md server/THREATS.md \
	$(wildcard server/deploy/*.*) server/backing_redis_script.h \
	tests/RELIABILITY.md tests/bench/RESULTS.md tests/contract/README.md \
	$(wildcard clients/*/README.md clients/web/previewer.png \
	clients/figures/*.png clients/figures/figures.json \
	clients/models/*.json clients/curl/*)

MANUALS := server/man/blobfieldd.8 server/man/blobfieldd.conf.5 \
	clients/c/blobfield.1
# name of a manual's file: where it is installed.
manual = $(DESTDIR)$(MANDIR)/man$(subst .,,$(suffix $(1)))/$(notdir $(1))
UNITS := $(wildcard server/deploy/systemd/blobfieldd.s*)
EXAMPLE_CONF := server/deploy/systemd/blobfieldd.conf
INSTALLED_CONF = $(DESTDIR)$(SYSCONFDIR)/blobfield/blobfieldd.conf

.PHONY: install
install: all
	install -D -m 755 $(B)/blobfieldd $(DESTDIR)$(PREFIX)/bin/blobfieldd
	install -D -m 755 $(B)/blobfield $(DESTDIR)$(PREFIX)/bin/blobfield
	install -D -m 644 clients/c/blobfield.h \
	    $(DESTDIR)$(PREFIX)/include/blobfield.h
	install -D -m 644 $(B)/libblobfield.a \
	    $(DESTDIR)$(PREFIX)/lib/libblobfield.a
	$(foreach m,$(MANUALS),install -D -m 644 $(m) $(call manual,$(m)) &&) :
	for f in $(UNITS); do \
		sed -e 's|@BINDIR@|$(PREFIX)/bin|' \
		    -e 's|@SYSCONFDIR@|$(SYSCONFDIR)|' $$f | \
		install -D -m 644 /dev/stdin \
		    $(DESTDIR)$(UNITDIR)/$$(basename $$f) || exit 1; done
	install -D -m 644 server/deploy/systemd/blobfield.sysusers \
	    $(DESTDIR)$(SYSUSERSDIR)/blobfield.conf
	[ -e $(INSTALLED_CONF) ] || \
	    install -D -m 644 $(EXAMPLE_CONF) $(INSTALLED_CONF)
	[ -n "$(DESTDIR)" ] || ! getent group blobfield >/dev/null || \
	    { chgrp blobfield $(INSTALLED_CONF) && \
	    chmod 640 $(INSTALLED_CONF); }
	for f in $(wildcard $(DOCS)); do \
		install -D -m 644 $$f $(DESTDIR)$(PREFIX)/share/doc/blobfield/$$f; \
	done

# But for a configuration that has been changed.
.PHONY: uninstall
uninstall:
	rm -f $(DESTDIR)$(PREFIX)/bin/blobfieldd \
	    $(DESTDIR)$(PREFIX)/bin/blobfield \
	    $(DESTDIR)$(PREFIX)/include/blobfield.h \
	    $(DESTDIR)$(PREFIX)/lib/libblobfield.a \
	    $(foreach m,$(MANUALS),$(call manual,$(m))) \
	    $(addprefix $(DESTDIR)$(UNITDIR)/,$(notdir $(UNITS))) \
	    $(DESTDIR)$(SYSUSERSDIR)/blobfield.conf
	rm -rf $(DESTDIR)$(PREFIX)/share/doc/blobfield
	! cmp -s $(EXAMPLE_CONF) $(INSTALLED_CONF) || rm -f $(INSTALLED_CONF)
	[ ! -d $(dir $(INSTALLED_CONF)) ] || \
	    rmdir --ignore-fail-on-non-empty $(dir $(INSTALLED_CONF))

# --- Debian -----------------------------------------------------------------

DEB = build/blobfield_$(VERSION)-1_$(shell dpkg --print-architecture).deb

.PHONY: deb
deb: packages-deb
	@rm -rf build/deb/debian build/blobfield_*.deb && mkdir -p build/deb/debian
	@cp server/deploy/debian/* build/deb/debian
	@server/deploy/debian/fill.sh $(VERSION) build/deb/debian
	@cd build/deb && DEB_BUILD_OPTIONS=noautodbgsym \
	    dpkg-buildpackage -b -us -uc -d
	@echo $(DEB)

.PHONY: test-package
test-package: packages-test-package deb
	@DEB=$(DEB) tests/run.sh tests/package/test_package.py

.PHONY: clean
clean:
	rm -rf build

.SECONDARY:
.DELETE_ON_ERROR:
-include $(shell find $(B) -name '*.d' -type f 2>/dev/null)
