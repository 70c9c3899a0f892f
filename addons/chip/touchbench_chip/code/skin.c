/* The least value of each code from 1 on, and the reading that each code stands for. */
#if CURVED
#define REACHES(value, code) ((value) >= code_values[(code) - 1])
#define READING_OF(code) code_readings[code]
#else
#define REACHES(value, code) ((value) >= FIRST_VALUE + CODE_STEP * (float)((code) - 1))
#define READING_OF(code) (FIRST_READING + CODE_STEP * (float)(code))
#endif

float touch_reading(int code)
{
    return code < 0 || code >= TOUCH_CODES ? (float)TOUCH_BAD : READING_OF(code);
}

/* The reading of a value after the converter. */
static float encoded(float value)
{
    if (!TOUCH_CODES)
        return value;
    int code = 0, most = TOUCH_CODES - 1;
    while (code < most) {
        int middle = (code + most + 1) / 2;
        if (REACHES(value, middle))
            code = middle;
        else
            most = middle - 1;
    }
    return READING_OF(code);
}

int touch_skin_init(touch_skin_t *s)
{
    if (!s)
        return TOUCH_BAD;
    memset(s, 0, sizeof *s);
    s->left = SAMPLING == MEAN ? PERIOD : 0;
    return 0;
}

int touch_skin(touch_skin_t *s, const float *recorded, float *frame)
{
    if (!s || !recorded || !frame)
        return TOUCH_BAD;
    for (int i = 0; i < TOUCH_RECORDED_TAXELS; i++)
        if (!(recorded[i] >= -NEGATIVE && recorded[i] <= FULL_SCALE)) /* not a number is neither */
            return TOUCH_BAD;
    int begins = s->left < OF_FRAME; /* a period of frames that are picked, or a peak, with this one */
    int ends = s->left <= OF_FRAME;  /* a period of a mean, in this frame or with it */
    int last = s->left + (begins ? PERIOD : 0) - OF_FRAME < OF_FRAME; /* of a period of a peak */
    int ready = SAMPLING == MEAN ? ends : SAMPLING == PICK ? begins : last;
    float part = (float)(ends ? s->left : OF_FRAME), rest = (float)(OF_FRAME - s->left);
    for (int i = 0, at = 0; i < TAXELS; i++) {
        float value = 0;
        for (; at < reading_ends[i]; at++)
            value += reading_weights[at] * fmaxf(recorded[reading_taxels[at]], 0);
        if (SAMPLING == MEAN)
            s->values[i] += part * value / (float)PERIOD;
        else
            s->values[i] = begins ? value : fmaxf(s->values[i], value);
        if (ready)
            frame[i] = encoded(s->values[i]);
        if (SAMPLING == MEAN && ready)
            s->values[i] = rest * value / (float)PERIOD;
    }
    s->left += (SAMPLING == MEAN ? ends : begins) ? PERIOD - OF_FRAME : -OF_FRAME;
    return ready;
}
