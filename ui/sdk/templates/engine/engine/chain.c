/* A hanging chain of masses and springs, integrated by the semi-implicit Euler method. It stands for whatever engine
 * you have: in C, C++, Fortran or CUDA, yours or a vendor's. */
#include "chain.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

/* Longest step that is taken at once [s]; a longer one is divided. */
#define STEP_MAX 0.0005
#define MASSES_MAX 1000000u

struct chain {
    uint32_t masses;
    double mass, length, stiffness, damping;
    double *positions, *velocities, *forces;
};

uint32_t chain_abi(void) { return CHAIN_ABI; }

static int is_above_zero(double x) { return isfinite(x) && x > 0.0; }

chain *chain_create(uint32_t masses, double mass, double length, double stiffness, double damping) {
    if (masses == 0 || masses > MASSES_MAX || !is_above_zero(mass) || !is_above_zero(length)
        || !is_above_zero(stiffness) || !isfinite(damping) || damping < 0.0)
        return NULL;
    chain *self = calloc(1, sizeof *self);
    if (!self) return NULL;
    *self = (chain){.masses = masses, .mass = mass, .length = length, .stiffness = stiffness, .damping = damping};
    self->positions = calloc(3 * (size_t)masses, sizeof(double));
    self->velocities = calloc(3 * (size_t)masses, sizeof(double));
    self->forces = calloc(3 * (size_t)masses, sizeof(double));
    if (!self->positions || !self->velocities || !self->forces) {
        chain_destroy(self);
        return NULL;
    }
    for (uint32_t i = 0; i < masses; i++) self->positions[3 * i + 2] = -length * (i + 1);
    return self;
}

void chain_destroy(chain *self) {
    if (!self) return;
    free(self->positions);
    free(self->velocities);
    free(self->forces);
    free(self);
}

int32_t chain_set(chain *self, const double *positions, const double *velocities, uint32_t numbers) {
    if (!self || !positions || !velocities || numbers != 3 * self->masses) return CHAIN_BAD_ARGUMENT;
    memcpy(self->positions, positions, numbers * sizeof(double));
    memcpy(self->velocities, velocities, numbers * sizeof(double));
    return CHAIN_OK;
}

int32_t chain_get(const chain *self, double *positions, double *velocities, uint32_t numbers) {
    if (!self || !positions || !velocities || numbers != 3 * self->masses) return CHAIN_BAD_ARGUMENT;
    memcpy(positions, self->positions, numbers * sizeof(double));
    memcpy(velocities, self->velocities, numbers * sizeof(double));
    return CHAIN_OK;
}

/* The force of the spring between a mass and the one above it, on both. */
static void pull(chain *self, uint32_t i) {
    static const double fixed[3] = {0.0, 0.0, 0.0};
    const double *above = i ? &self->positions[3 * (i - 1)] : fixed;
    const double *above_velocity = i ? &self->velocities[3 * (i - 1)] : fixed;
    const double *below = &self->positions[3 * i], *below_velocity = &self->velocities[3 * i];
    double along[3], stretch = 0.0, rate = 0.0;
    for (int k = 0; k < 3; k++) along[k] = above[k] - below[k];
    double length = sqrt(along[0] * along[0] + along[1] * along[1] + along[2] * along[2]);
    if (length < 1e-12) return;
    for (int k = 0; k < 3; k++) {
        along[k] /= length;
        rate += along[k] * (above_velocity[k] - below_velocity[k]);
    }
    stretch = length - self->length;
    double tension = self->stiffness * stretch + self->damping * rate;
    for (int k = 0; k < 3; k++) {
        self->forces[3 * i + k] += tension * along[k];
        if (i) self->forces[3 * (i - 1) + k] -= tension * along[k];
    }
}

int32_t chain_step(chain *self, double seconds, double gravity, const double force[3]) {
    if (!self || !force || !is_above_zero(seconds) || seconds > 1.0 || !isfinite(gravity)) return CHAIN_BAD_ARGUMENT;
    uint32_t numbers = 3 * self->masses, steps = (uint32_t)ceil(seconds / STEP_MAX);
    double dt = seconds / steps;
    for (uint32_t step = 0; step < steps; step++) {
        for (uint32_t n = 0; n < numbers; n++) self->forces[n] = n % 3 == 2 ? self->mass * gravity : 0.0;
        for (int k = 0; k < 3; k++) self->forces[numbers - 3 + k] += force[k];
        for (uint32_t i = 0; i < self->masses; i++) pull(self, i);
        for (uint32_t n = 0; n < numbers; n++) {
            self->velocities[n] += dt * self->forces[n] / self->mass;
            self->positions[n] += dt * self->velocities[n];
        }
    }
    return CHAIN_OK;
}
