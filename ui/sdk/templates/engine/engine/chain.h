/* The ABI of the engine: what the two sides agree on. Plain C types, an opaque handle, no callbacks, no globals.
 *
 * Its first rule: all state can be read and set (chain_get, chain_set). An engine that hides state cannot go on
 * after a failure, cannot be branched, and cannot be replayed. */
#ifndef CHAIN_H
#define CHAIN_H

#include <stdint.h>

/* Raised with every change of what stands below. */
#define CHAIN_ABI 1u

/* What a call answers. */
#define CHAIN_OK 0
#define CHAIN_BAD_ARGUMENT 1

typedef struct chain chain;

/* The version that the library was built for. Asked before anything else. */
uint32_t chain_abi(void);

/* `masses` point masses of `mass` [kg] each, hung one below the other from a fixed point at (0, 0, 0), joined by
 * springs of length `length` [m] at rest, `stiffness` [N/m] and `damping` [N.s/m]. NULL when a figure makes no
 * sense or memory is short. */
chain *chain_create(uint32_t masses, double mass, double length, double stiffness, double damping);

/* Positions [m] and velocities [m/s] of every mass: 3 numbers each, `numbers` = 3 * masses in each array. */
int32_t chain_set(chain *self, const double *positions, const double *velocities, uint32_t numbers);
int32_t chain_get(const chain *self, double *positions, double *velocities, uint32_t numbers);

/* Advances by `seconds`, with gravity [m/s2] along z and a force [N] on the last mass. */
int32_t chain_step(chain *self, double seconds, double gravity, const double force[3]);

void chain_destroy(chain *self);

#endif
