
/* A design of the skin: frames of a recorded skin ($grid taxels at $rate Hz, row by row, numbered from 1) become
   frames that touch_push takes. A skin that is built to this design delivers them itself. Each reading is
   the weighted mean of recorded ones, in this order:
$readings
   $frames
   $codes */
#define TOUCH_RECORDED_TAXELS $recorded
#define TOUCH_CODES $count /* of the converter; 0 if readings pass as they are */

typedef struct {
    int32_t left; /* of a period */
    float values[$taxels]; /* of this period */
} touch_skin_t;

/* Begin a capture or a stream of recorded frames; 0, or TOUCH_BAD. */
int touch_skin_init(touch_skin_t *s);

/* Take a recorded frame: 1 if frame has become the next one for touch_push, 0 if not yet, or TOUCH_BAD. */
int touch_skin(touch_skin_t *s, const float *recorded, float *frame);

/* The reading that a code of the converter stands for, or TOUCH_BAD. */
float touch_reading(int code);
