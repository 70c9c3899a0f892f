/* $title */
#ifndef TOUCH_H
#define TOUCH_H

#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

#define TOUCH_VERSION "$version" /* of touchbench, which wrote this code */
#define TOUCH_MODEL "$model" /* changes with the code and with what was learnt */
$public

/* Return codes below 0. */
#define TOUCH_BAD -1   /* no state or frame, or a reading that is no number or out of range */
#define TOUCH_LONG -2  /* the capture is longer than any that was learnt from: begin a new one */
#define TOUCH_EMPTY -3 /* nothing was touched yet */

/* What a capture looks like as a whole. */
typedef struct {
    int frames;
    float mean, largest, least, across, down, zeros;
} touch_look_t;

$state
/* The linker refuses a program with two models, and one that was compiled with the header of another model; with a
   prefix= of its own for each model, bench export writes models that fit together. */
#define touch_init touch_init_$model
#define touch_look_init touch_look_init_$model

/* Begin a capture; the state is all the memory that is needed. */
int touch_init(touch_t *t);

/* Take a frame, row by row, readings from 0 to TOUCH_FULL_SCALE: 1 if there is a new decision, 0 if not yet, or a code.
   Readings from -TOUCH_NEGATIVE to 0 are taken for 0. A frame that is refused changes nothing. */
int touch_push(touch_t *t, const float *frame);

/* The class of what has been seen since the beginning, or a code; and probabilities of all classes.
   $settled
   settled may be NULL. */
int touch_label(touch_t *t, float *probabilities, float *settled);

/* What a class is called. */
const char *touch_name(int label);

/* Whether a capture looks unlike all that training saw: another range, inverted readings, another order of taxels.
   Push each of its frames here, too, and ask at its end: 1 if so, 0, or a code. */
int touch_look_init(touch_look_t *look);
int touch_look(touch_look_t *look, const float *frame);
int touch_unlike(const touch_look_t *look);
$skin$watch
#ifdef __cplusplus
}
#endif

#endif
