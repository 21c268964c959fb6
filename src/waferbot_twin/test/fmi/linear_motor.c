// SPDX-License-Identifier: Apache-2.0
/*
 * A mass on a linear motor as an FMU of FMI 2.0 for co-simulation, in C: no line of it is waferbot's.
 *
 *     m x'' = sum of k s_w i_w,   L i_w' = u_w - R i_w - k s_w x',   s_w = sin(2 pi x / cycle + phase of w)
 *
 * for the three windings w of a delta, between the terminals 12, 23, 31; classical Runge-Kutta of fourth
 * order, 20 steps for each step of communication, in which the voltages are held. The scale is read every
 * second step, and shows what it read the time before.
 */
#include <math.h>
#include <stdlib.h>

#define EXPORT __attribute__((visibility("default")))

enum { U_A, U_B, U_C, POSITION, SPEED, I_A, I_B, COUNTS, VARIABLES };

static const double pi = 3.14159265358979323846;
static const double mass = 10.0, resistance = 3.0, inductance = 0.012, emf = 60.0, cycle = 0.032;
static const double counts_per_m = 5.0e7;
static const int steps = 20;

typedef struct {
    double voltage[3];
    double state[5]; /* position, speed, currents of the windings */
    int taken, read, shown; /* steps; counts */
} Machine;

static void rates(const Machine *machine, const double *state, double *rate) {
    double force = 0.0;
    for (int w = 0; w < 3; ++w) {
        double phase = emf * sin(2.0 * pi * state[0] / cycle + pi / 6.0 - 2.0 * pi / 3.0 * w);
        double across = machine->voltage[w] - machine->voltage[(w + 1) % 3];
        force += phase * state[2 + w];
        rate[2 + w] = (across - resistance * state[2 + w] - phase * state[1]) / inductance;
    }
    rate[0] = state[1];
    rate[1] = force / mass;
}

static void advance(Machine *machine, double h) {
    static const double share[4] = {0.0, 0.5, 0.5, 1.0}, weight[4] = {1.0, 2.0, 2.0, 1.0};
    double sum[5] = {0}, rate[5] = {0}, at[5];
    for (int stage = 0; stage < 4; ++stage) {
        for (int n = 0; n < 5; ++n) at[n] = machine->state[n] + share[stage] * h * rate[n];
        rates(machine, at, rate);
        for (int n = 0; n < 5; ++n) sum[n] += weight[stage] / 6.0 * rate[n];
    }
    for (int n = 0; n < 5; ++n) machine->state[n] += h * sum[n];
}

EXPORT const char *fmi2GetTypesPlatform(void) { return "default"; }
EXPORT const char *fmi2GetVersion(void) { return "2.0"; }
EXPORT int fmi2SetDebugLogging(void *m, int on, size_t n, const char *const names[]) { return 0; }

EXPORT void *fmi2Instantiate(const char *name, int type, const char *token, const char *resources,
                             const void *callbacks, int visible, int logging) {
    return calloc(1, sizeof(Machine));
}
EXPORT void fmi2FreeInstance(void *m) { free(m); }
EXPORT int fmi2SetupExperiment(void *m, int defined, double t, double start, int ends, double stop) {
    return 0;
}
EXPORT int fmi2EnterInitializationMode(void *m) { return 0; }
EXPORT int fmi2ExitInitializationMode(void *m) { return 0; }
EXPORT int fmi2Terminate(void *m) { return 0; }
EXPORT int fmi2Reset(void *m) {
    *(Machine *)m = (Machine){0};
    return 0;
}

EXPORT int fmi2GetReal(void *m, const unsigned refs[], size_t n, double values[]) {
    const Machine *machine = m;
    const double *s = machine->state;
    const double shown[VARIABLES] = {
        machine->voltage[0], machine->voltage[1], machine->voltage[2], s[0], s[1],
        s[2] - s[4], s[3] - s[2], 0.0,
    };
    for (size_t place = 0; place < n; ++place) {
        if (refs[place] >= COUNTS) return 3;
        values[place] = shown[refs[place]];
    }
    return 0;
}
EXPORT int fmi2SetReal(void *m, const unsigned refs[], size_t n, const double values[]) {
    for (size_t place = 0; place < n; ++place) {
        if (refs[place] > U_C) return 3;
        ((Machine *)m)->voltage[refs[place]] = values[place];
    }
    return 0;
}
EXPORT int fmi2GetInteger(void *m, const unsigned refs[], size_t n, int values[]) {
    for (size_t place = 0; place < n; ++place) {
        if (refs[place] != COUNTS) return 3;
        values[place] = ((Machine *)m)->shown;
    }
    return 0;
}
EXPORT int fmi2DoStep(void *m, double now, double step, int no_set_before) {
    Machine *machine = m;
    for (int part = 0; part < steps; ++part) advance(machine, step / steps);
    if (++machine->taken % 2 == 0) {
        machine->shown = machine->read;
        machine->read = (int)floor(counts_per_m * machine->state[0]);
    }
    return 0;
}

/* What the standard wants to be there, and this machine has nothing for. */
#define NOTHING(name) \
    EXPORT int name(void) { return 3; }
NOTHING(fmi2GetBoolean)
NOTHING(fmi2SetBoolean)
NOTHING(fmi2SetInteger)
NOTHING(fmi2GetString)
NOTHING(fmi2SetString)
NOTHING(fmi2GetFMUstate)
NOTHING(fmi2SetFMUstate)
NOTHING(fmi2FreeFMUstate)
NOTHING(fmi2SerializedFMUstateSize)
NOTHING(fmi2SerializeFMUstate)
NOTHING(fmi2DeSerializeFMUstate)
NOTHING(fmi2GetDirectionalDerivative)
NOTHING(fmi2SetRealInputDerivatives)
NOTHING(fmi2GetRealOutputDerivatives)
NOTHING(fmi2CancelStep)
NOTHING(fmi2GetStatus)
NOTHING(fmi2GetRealStatus)
NOTHING(fmi2GetIntegerStatus)
NOTHING(fmi2GetBooleanStatus)
NOTHING(fmi2GetStringStatus)
